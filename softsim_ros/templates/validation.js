const sessions = data.sessions;
let s, chosen = -1, turn = 0.6, tilt = 0.45, zoom = 1, projected = [];
const size = e => Math.hypot(e[0], e[1], e[2]);
function draw() {
  const canvas = get('field'), pen = canvas.getContext('2d');
  const factor = Number(get('length').value);
  get('times').textContent = factor + ' times';
  const low = [0, 1, 2].map(k => Math.min(...s.places.map(p => p[k])));
  const high = [0, 1, 2].map(k => Math.max(...s.places.map(p => p[k])));
  const middle = low.map((v, k) => (v + high[k]) / 2);
  const reach = Math.max(1e-6, Math.hypot(...low.map((v, k) => high[k] - v)));
  const scale = 0.82 * Math.min(canvas.width, canvas.height) / reach * zoom;
  const [ct, st, cp, sp] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
  const flat = p => {
    const [x, y, z] = p.map((v, k) => v - middle[k]);
    const right = ct * x + st * y, away = -st * x + ct * y;
    return [canvas.width / 2 + scale * right, canvas.height / 2 - scale * (cp * z + sp * away),
      cp * away - sp * z];
  };
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.strokeStyle = '#bbb'; pen.lineWidth = 1; pen.fillStyle = '#555'; pen.font = '13px sans-serif';
  const corner = b => [0, 1, 2].map(k => (b >> k) & 1 ? high[k] : low[k]);
  for (let b = 0; b < 8; b++) for (let k = 0; k < 3; k++) if (!((b >> k) & 1)) {
    const [a, c] = [flat(corner(b)), flat(corner(b | (1 << k)))];
    pen.beginPath(); pen.moveTo(a[0], a[1]); pen.lineTo(c[0], c[1]); pen.stroke();
    if (b === 0) pen.fillText(`${'xyz'[k]} ${low[k].toFixed(1)} to ${high[k].toFixed(1)} mm`,
      (a[0] + c[0]) / 2 + 6, (a[1] + c[1]) / 2 + 14);
  }
  const lengths = s.errors.map(size), most = Math.max(...lengths, 1e-9);
  projected = s.places.map((p, k) => [...flat(p), k]);
  for (const [x, y, , k] of [...projected].sort((a, b) => b[2] - a[2])) {
    const end = flat(s.places[k].map((v, i) => v + factor * s.errors[k][i]));
    pen.strokeStyle = pen.fillStyle = colour(lengths[k] / most);
    pen.lineWidth = k === chosen ? 3 : 1;
    pen.beginPath(); pen.moveTo(x, y); pen.lineTo(end[0], end[1]); pen.stroke();
    pen.beginPath(); pen.arc(x, y, k === chosen ? 6 : 2.2, 0, 7); pen.fill();
    if (k === chosen) { pen.strokeStyle = '#000'; pen.stroke(); }
  }
  colourScale(pen, 12, canvas.height - 22, 160);
  pen.fillStyle = '#333'; pen.fillText(`0 to ${most.toFixed(2)} mm`, 180, canvas.height - 12);
}
function choose(k) {
  chosen = k;
  [...get('worst').rows].forEach((row, n) => row.classList.toggle('on', s.worst[n] === k));
  const e = s.errors[k], three = v => v.map(c => c.toFixed(2)).join(', ');
  get('chosen').textContent = `${s.labels[k]}: ${size(e).toFixed(2)} mm\n` +
    `model minus measured: ${three(e)} mm\n` +
    `measured at: ${three(s.places[k])} mm\n${s.commands[k]}`;
  draw();
}
function show(n) {
  s = sessions[n]; chosen = -1;
  get('note').textContent = s.note;
  get('chosen').textContent = 'Click a line or a point.';
  const top = Math.max(...s.counts, 1), last = s.edges[s.edges.length - 1], wide = 400 / s.counts.length;
  get('histogram').replaceChildren(...s.counts.map((c, k) => {
    const [low, high] = [s.edges[k], s.edges[k + 1]], height = 120 * c / top;
    const bar = node('rect', {x: 10 + k * wide, y: 130 - height, width: wide - 1, height,
      fill: colour((low + high) / 2 / last)});
    bar.append(node('title', {}, `${c} from ${low.toFixed(2)} to ${high.toFixed(2)} mm`));
    return bar;
  }), node('text', {x: 10, y: 147, 'font-size': 12}, s.edges[0].toFixed(2)),
  node('text', {x: 410, y: 147, 'font-size': 12, 'text-anchor': 'end'}, `${last.toFixed(2)} mm`));
  fillTable('worst', s.worst.map(k => [`${size(s.errors[k]).toFixed(2)} mm`, s.labels[k]]));
  [...get('worst').rows].forEach((row, k) => row.onclick = () => choose(s.worst[k]));
  fillTable('regions', s.regions);
  fillTable('alignment', s.alignment);
  draw();
}
if (sessions.length) {
  const canvas = get('field');
  let from = null, moved = 0;
  canvas.onpointerdown = e => {
    from = [e.clientX, e.clientY]; moved = 0; canvas.setPointerCapture(e.pointerId);
  };
  canvas.onpointermove = e => {
    if (!from) return;
    const [dx, dy] = [e.clientX - from[0], e.clientY - from[1]];
    moved += Math.abs(dx) + Math.abs(dy); turn -= dx / 150; from = [e.clientX, e.clientY];
    tilt = Math.max(-1.57, Math.min(1.57, tilt + dy / 150)); draw();
  };
  canvas.onpointerup = e => {
    from = null;
    if (moved > 4) return;
    const box = canvas.getBoundingClientRect();
    const [x, y] = [e.clientX - box.left, e.clientY - box.top];
    const far = projected.map(p => [Math.hypot(p[0] - x, p[1] - y), p[3]]);
    const near = far.sort((a, b) => a[0] - b[0])[0];
    if (near && near[0] < 15) choose(near[1]);
  };
  canvas.onwheel = e => { e.preventDefault(); zoom *= Math.exp(-e.deltaY / 600); draw(); };
  get('length').oninput = draw;
  showTabs('sessions', sessions.map(each => each.name), show);
}
