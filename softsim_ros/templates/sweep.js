const axes = [...data.variables, ...data.quantities];
const short = v => Number(v.toPrecision(4)).toString();
const label = a => a.unit ? `${a.name}, ${a.unit}` : a.name;
let q, kept = {};  // the chosen quantity; interval of each axis whose runs are kept
for (const a of axes) {
  a.low = Math.min(...a.values); a.high = Math.max(...a.values); a.span = a.high - a.low || 1;
}
const passes = r => Object.entries(kept).every(([k, [low, high]]) =>
  axes[k].values[r] >= low && axes[k].values[r] <= high);
const right = k => 70 + k * 1060 / Math.max(1, axes.length - 1);
const up = (a, v) => 290 - 250 * (v - a.low) / a.span;
function lines() {
  const parts = [];
  q.values.forEach((v, r) => {
    const on = passes(r), points = axes.map((a, k) => `${right(k)},${up(a, a.values[r]).toFixed(1)}`);
    parts[on ? 'push' : 'unshift'](node('polyline', {points: points.join(' '), fill: 'none',
      stroke: on ? colour((v - q.low) / q.span) : '#ddd', 'stroke-width': on ? 1.2 : 0.6}));
  });
  axes.forEach((a, k) => {
    const x = right(k), end = k === axes.length - 1 ? 'end' : k ? 'middle' : 'start';
    const bold = a === q ? 'bold' : 'normal';
    parts.push(node('line', {x1: x, x2: x, y1: 40, y2: 290, stroke: '#333'}),
      node('text', {x, y: 16, 'font-size': 13, 'text-anchor': end, 'font-weight': bold}, label(a)),
      node('text', {x, y: 33, 'font-size': 12, 'text-anchor': end}, short(a.high)),
      node('text', {x, y: 308, 'font-size': 12, 'text-anchor': end}, short(a.low)));
    if (kept[k]) parts.push(node('rect', {x: x - 6, width: 12, y: up(a, kept[k][1]),
      height: Math.max(2, up(a, kept[k][0]) - up(a, kept[k][1])), fill: '#fa06', stroke: '#c70'}));
  });
  const count = q.values.filter((v, r) => passes(r)).length;
  if (Object.keys(kept).length) parts.push(node('text', {x: 600, y: 326, 'font-size': 12,
    'text-anchor': 'middle'}, `${count} of ${q.values.length} runs`));
  get('lines').replaceChildren(...parts);
}
function effects() {
  get('effects').replaceChildren(...data.variables.map(a => {
    const box = node('svg', {viewBox: '0 0 300 210'}), x = v => 70 + 220 * (v - a.low) / a.span;
    const y = v => 165 - 150 * (v - q.low) / q.span, levels = new Set(a.values), groups = new Map();
    a.values.forEach((v, r) => {
      const key = levels.size <= 12 ? v : Math.min(9, Math.floor(10 * (v - a.low) / a.span));
      if (!groups.has(key)) groups.set(key, [0, 0, 0]);
      const g = groups.get(key); g[0] += v; g[1] += q.values[r]; g[2] += 1;
      box.append(node('circle', {cx: x(v), cy: y(q.values[r]), r: 1.8, fill: '#38c6'}));
    });
    const means = [...groups.values()].map(([s, t, n]) => [s / n, t / n]).sort((p, o) => p[0] - o[0]);
    box.append(node('polyline', {points: means.map(([s, t]) => `${x(s)},${y(t)}`).join(' '),
      fill: 'none', stroke: '#c30', 'stroke-width': 2}));
    means.forEach(([s, t]) => box.append(node('circle', {cx: x(s), cy: y(t), r: 3, fill: '#c30'})));
    const text = (px, py, words, anchor) => box.append(
      node('text', {x: px, y: py, 'font-size': 11, 'text-anchor': anchor}, words));
    text(70, 182, short(a.low), 'start'); text(290, 182, short(a.high), 'end');
    text(180, 200, label(a), 'middle');
    text(66, 165, short(q.low), 'end'); text(66, 20, short(q.high), 'end');
    return box;
  }));
}
function surface() {
  const canvas = get('surface'), pen = canvas.getContext('2d'), s = q.surface;
  const [i, j] = [Number(get('first').value), Number(get('second').value)];
  const a = data.variables[i], b = data.variables[j] || a, cells = 60, wide = 440, high = 340;
  pen.clearRect(0, 0, canvas.width, canvas.height);
  const value = (u, v) => {
    const t = data.variables.map((_, k) => k === i ? u : k === j ? v : 0);
    return s.terms.reduce((sum, term, k) => sum + s.coefficients[k] * term.reduce((p, m) => p * t[m], 1), 0);
  };
  const grid = [];
  for (let m = 0; m < cells; m++) for (let n = 0; n < cells; n++)
    grid.push(value(2 * (m + 0.5) / cells - 1, 2 * (n + 0.5) / cells - 1));
  const low = Math.min(...grid), span = Math.max(...grid) - low || 1;
  grid.forEach((v, k) => {
    pen.fillStyle = colour((v - low) / span);
    const [m, n] = [Math.floor(k / cells), k % cells];
    const [x, y] = [60 + m * wide / cells, 20 + (cells - 1 - n) * high / cells];
    pen.fillRect(x, y, wide / cells + 1, high / cells + 1);
  });
  pen.fillStyle = '#0008';
  a.values.forEach((v, r) => pen.fillRect(59 + wide * (v - a.low) / a.span,
    19 + high - high * (b.values[r] - b.low) / b.span, 2.5, 2.5));
  pen.fillStyle = '#333'; pen.font = '12px sans-serif';
  pen.fillText(short(a.low), 60, 378); pen.fillText(short(a.high), 480, 378);
  pen.fillText(label(a), 230, 378); pen.fillText(short(b.low), 5, 360); pen.fillText(short(b.high), 5, 30);
  pen.fillText(label(b), 5, 12);
  colourScale(pen, 60, 390, 300);
  pen.fillStyle = '#333'; pen.fillText(`${short(low)} to ${short(low + span)} ${q.unit}`, 370, 400);
  get('fit').textContent = `Quadratic fit of ${q.name} over all variables: it explains ` +
    `${(100 * s.share).toFixed(1)} % of the variance. Dots are runs.`;
}
function extremes() {
  const order = q.values.map((v, r) => r).sort((r, s) => q.values[s] - q.values[r]);
  const some = [...new Set([...order.slice(0, 5), ...order.slice(-5)])];
  fillTable('extremes', [['run', ...data.variables.map(label), label(q)], ...some.map(r => [data.runs[r],
    ...data.variables.map(a => short(a.values[r])), short(q.values[r])])], 1);
}
if (data.quantities.length) {
  for (const [id, start] of [['first', 0], ['second', Math.min(1, data.variables.length - 1)]]) {
    get(id).replaceChildren(...data.variables.map((a, k) => new Option(a.name, k, k === start, k === start)));
    get(id).onchange = surface;
  }
  const box = get('lines');
  const place = e => {
    const inverse = box.getScreenCTM().inverse();
    const p = new DOMPoint(e.clientX, e.clientY).matrixTransform(inverse);
    return [p.x, p.y];
  };
  let from = null;
  box.onpointerdown = e => {
    const [x, y] = place(e), k = axes.findIndex((_, n) => Math.abs(right(n) - x) < 20);
    if (k < 0) { kept = {}; lines(); return; }
    from = [k, y]; box.setPointerCapture(e.pointerId);
  };
  box.onpointermove = e => {
    if (!from) return;
    const [k, y] = from, a = axes[k], at = v => a.low + a.span * (290 - v) / 250, other = at(place(e)[1]);
    kept[k] = [Math.min(at(y), other), Math.max(at(y), other)]; lines();
  };
  box.onpointerup = () => { from = null; };
  showTabs('quantities', data.quantities.map(label), n => {
    q = data.quantities[n]; lines(); effects(); extremes();
    if (data.variables.length) surface();
  });
}
