const get = id => document.getElementById(id);
const data = JSON.parse(get('data').textContent);
function colour(part) {  // blue, green, yellow, red
  const p = Math.max(0, Math.min(1, part));
  return `hsl(${Math.round(230 - 230 * p)} 85% ${45 + 5 * p}%)`;
}
function colourScale(pen, left, top, width) {
  for (let k = 0; k < 100; k++) {
    pen.fillStyle = colour(k / 100); pen.fillRect(left + k * width / 100, top, width / 100 + 1, 10);
  }
}
function node(name, attributes, text) {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}
const element = (name, text = '') => Object.assign(document.createElement(name), {textContent: text});
function fillTable(id, rows, heads = 0) {
  get(id).replaceChildren(...rows.map((row, k) => {
    const line = element('tr');
    line.append(...row.map(each => element(k < heads ? 'th' : 'td', each)));
    return line;
  }));
}
function showTabs(id, names, show) {  // a button per name; the first is chosen
  const choose = n => { buttons.forEach((b, k) => b.classList.toggle('on', k === n)); show(n); };
  const buttons = names.map((name, n) => Object.assign(element('button', name), {onclick: () => choose(n)}));
  get(id).replaceChildren(...buttons);
  choose(0);
}
