"""The web page of `softsim sweep --report`: one self-contained file."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.base import Array, StudyError, write_file
from softsim_core.lab.study import StudyResults, response_surface
from softsim_ros.cli.measurements import PAGE

STYLE: Final = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 84rem; margin: 1rem auto; padding: 0 1rem;
  color: #222 }
h1 { font-size: 1.5rem; margin: 0 0 .3rem } h2 { font-size: 1rem; margin: .9rem 0 .2rem }
p { margin: .15rem 0; color: #555 } table { border-collapse: collapse; font-size: .87rem }
td, th { padding: .1rem .9rem .1rem 0; text-align: left }
table.numbers td, table.numbers th { text-align: right }
.row { display: flex; gap: 1.5rem; flex-wrap: wrap } svg { max-width: 100%; background: #fff }
canvas { border: 1px solid #ccc }
nav { margin: .5rem 0 .2rem } nav button { font: inherit; padding: .15rem .6rem; margin: 0 .3rem .3rem 0 }
nav button.on { background: #234; color: #fff } select { font: inherit }
#lines { width: 100%; cursor: crosshair } #effects svg { width: 300px }
pre { white-space: pre-wrap; background: #f5f5f5; padding: .6rem }
"""

SCRIPT: Final = """
'use strict';
const data = JSON.parse(document.getElementById('data').textContent);
const get = id => document.getElementById(id);
const axes = [...data.variables, ...data.quantities];
const short = v => Number(v.toPrecision(4)).toString();
const label = a => a.unit ? `${a.name}, ${a.unit}` : a.name;
let now = 0, kept = {};
for (const a of axes) {
  a.low = Infinity; a.high = -Infinity;
  for (const v of a.values) { a.low = Math.min(a.low, v); a.high = Math.max(a.high, v); }
  a.span = a.high - a.low || 1;
}
function colour(part) {  // blue, green, yellow, red
  const p = Math.max(0, Math.min(1, part));
  return `hsl(${Math.round(230 - 230 * p)} 85% ${45 + 5 * p}%)`;
}
function node(name, attributes, text) {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}
const passes = r => Object.entries(kept).every(([k, [low, high]]) =>
  axes[k].values[r] >= low && axes[k].values[r] <= high);
const right = k => 70 + k * 1060 / Math.max(1, axes.length - 1);
const up = (a, v) => 290 - 250 * (v - a.low) / a.span;
function lines() {
  const q = data.quantities[now], parts = [];
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
  const q = data.quantities[now];
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
  const canvas = get('surface'), pen = canvas.getContext('2d'), q = data.quantities[now], s = q.surface;
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
  for (let k = 0; k < 100; k++) { pen.fillStyle = colour(k / 100); pen.fillRect(60 + 3 * k, 390, 4, 10); }
  pen.fillStyle = '#333'; pen.fillText(`${short(low)} to ${short(low + span)} ${q.unit}`, 370, 400);
  get('fit').textContent = `Quadratic fit of ${q.name} over all variables: it explains ` +
    `${(100 * s.share).toFixed(1)} % of the variance. Dots are runs.`;
}
function extremes() {
  const q = data.quantities[now], order = q.values.map((v, r) => r).sort((r, s) => q.values[s] - q.values[r]);
  const some = [...new Set([...order.slice(0, 5), ...order.slice(-5)])];
  const head = ['run', ...data.variables.map(label), label(q)];
  const rows = [head, ...some.map(r => [data.runs[r], ...data.variables.map(a => short(a.values[r])),
    short(q.values[r])])];
  get('extremes').replaceChildren(...rows.map((row, k) => {
    const line = document.createElement('tr');
    for (const each of row) {
      const cell = document.createElement(k ? 'td' : 'th'); cell.textContent = each; line.append(cell);
    }
    return line;
  }));
}
function show(n) {
  now = n;
  [...get('quantities').children].forEach((b, k) => b.classList.toggle('on', k === n));
  lines(); effects(); extremes();
  if (data.variables.length) surface();
}
if (data.quantities.length) {
  get('quantities').replaceChildren(...data.quantities.map((q, n) => {
    const button = document.createElement('button');
    button.textContent = label(q); button.onclick = () => show(n);
    return button;
  }));
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
  show(0);
}
"""


MOST_RUNS = 3000
"""Largest number of drawn runs; of more, an evenly spaced selection. Printed numbers refer to all runs."""

MOST_ERRORS = 20

VIEW = """
<nav id="quantities"></nav>
<div><h2>All runs</h2><svg id="lines" viewBox="0 0 1200 330"></svg>
<p>A line is a run, coloured by what is chosen above. Drag along an axis to keep the runs that pass
there, click beside the axes to keep all.</p></div>
<h2>Main effects</h2><div class="row" id="effects"></div>
<p>Points are runs; the line is their mean at each value, or in ten equal parts of the range.</p>
<div class="row"><div><h2>Response surface</h2>
<p>over <select id="first"></select> and <select id="second"></select>; other variables at their middle</p>
<canvas id="surface" width="560" height="420"></canvas><p id="fit"></p></div>
<div><h2>Best and worst runs</h2><table class="numbers" id="extremes"></table></div></div>
"""


def write(file: Path, results: StudyResults) -> None:
    """Write the page.

    Raises:
        StudyError: the file cannot be written, or no run is done.
    """
    try:
        write_file(file, page(results))
    except OSError as error:
        raise StudyError(f"{file} cannot be written ({error.strerror})") from error


def page(results: StudyResults) -> str:
    """Return the page as HTML.

    Raises:
        StudyError: no run is done.
    """
    if not results.done.any():
        raise StudyError(f"{results.folder}: no run is done, there is nothing to draw")
    study = results.attributes["study"]
    text = escape(results.attributes["study_text"])
    counted = ", ".join(f"{count} {word.replace('_', ' ')}" for word, count in results.counts.items())
    parts = [
        f"<p>{escape(study['about'])}</p>",
        f"<p><b>{len(results.status)} runs</b> of {escape(study['scene'])}: {escape(counted)}</p>",
        VIEW,
        _errors(results),
        f"<details><summary>The study</summary><pre>{text}</pre></details>",
    ]
    data = json.dumps(_data(results), allow_nan=False)
    return PAGE.format(
        title=escape(study["name"]),
        style=STYLE,
        body="\n".join(parts),
        data=data.replace("<", "\\u003c"),
        script=SCRIPT,
    )


def _errors(results: StudyResults) -> str:
    failed = [(number, error) for number, error in enumerate(results.errors) if error]
    if not failed:
        return ""
    rows = "".join(f"<tr><td>{number}<td>{escape(error)}" for number, error in failed[:MOST_ERRORS])
    more = f"<p>and {len(failed) - MOST_ERRORS} more</p>" if len(failed) > MOST_ERRORS else ""
    return f"<h2>Runs that failed</h2><table><tr><th>run<th>why{rows}</table>{more}"


def _data(results: StudyResults) -> dict[str, Any]:
    """Return the data that the page draws: finished runs, and a fitted surface of each quantity."""
    done = np.flatnonzero(results.done)
    shown = done[np.unique(np.linspace(0, len(done) - 1, min(len(done), MOST_RUNS)).astype(int))]
    varied = {name: each for name, each in results.variables.items() if np.ptp(each[done]) > 0.0}
    points = np.array([each[done] for each in varied.values()]).T.reshape(len(done), len(varied))
    surfaces = {
        name: response_surface(points, each[done]).plain()
        for name, each in results.quantities.items()
        if np.isfinite(each[done]).all()
    }
    return {
        "runs": shown.tolist(),
        "variables": [_axis(results, name, each[shown]) for name, each in varied.items()],
        "quantities": [
            _axis(results, name, results.quantities[name][shown]) | {"surface": surface}
            for name, surface in surfaces.items()
        ],
    }


def _axis(results: StudyResults, name: str, values: Array) -> dict[str, Any]:
    return {"name": name, "unit": results.units[name], "values": [float(f"{each:.7g}") for each in values]}
