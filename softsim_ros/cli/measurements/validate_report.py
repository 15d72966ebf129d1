"""The report of `softsim validate`: a table of errors, and a self-contained web page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np

from softsim_core.base import DataError, write_file
from softsim_core.lab.identification import (
    DataSetDescription,
    Measures,
    SessionResult,
    measures,
    summary,
    worst,
)
from softsim_core.physics.mechanics import rotation_log

HEAD = ("session", "errors", "raw mean", "mean", "rms", "p95", "max")
SHOWN_WORST = 3


def report_lines(
    description: DataSetDescription, model: str | None, results: Sequence[SessionResult]
) -> list[str]:
    """Return the report as lines of text."""
    asked = [each for each in results if each.alignment is not None]
    lines = [f"{description.name}: {description.about}" if description.about else description.name]
    if model is not None:
        lines.append(f"model: {model}; errors in mm, model minus measurement, aligned as described")
    lines += ["", *_text_table(results, asked)]
    for each in results:
        lines += ["", f"{each.session.name}: {each.session.description.note}".rstrip(": "), *_details(each)]
    if missing := [n for n in description.session_names if n not in {r.session.name for r in results}]:
        lines += ["", f"not compared: {', '.join(missing)}"]
    return lines


def _text_table(results: Sequence[SessionResult], asked: Sequence[SessionResult]) -> list[str]:
    rows: list[tuple[str, ...]] = [HEAD]
    for each in results:
        name, evaluated = each.session.name, each.evaluated
        if each.alignment is not None:
            rows.append((name, *_cells(each.of(evaluated), each.of(evaluated, raw=True))))
        for other, errors in each.others.items():
            session_rows = each.session.evaluated
            found = measures(errors.aligned[session_rows]), measures(errors.raw[session_rows])
            rows.append((f"{name}, {other} *", *_cells(*found)))
    if len(asked) > 1:
        raw = measures(np.concatenate([each.raw[each.evaluated].reshape(-1, 3) for each in asked]))
        rows.append(("all", *_cells(summary(asked), raw)))
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEAD))]
    lines = [
        "  ".join(
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
    if any(each.others for each in results):
        lines.append("* another model; a rigid frame is fitted, no sensor point: the data have no tilt of it")
    return lines


def _cells(aligned: Measures, raw: Measures) -> tuple[str, ...]:
    values = (raw.mean, aligned.mean, aligned.rms, aligned.p95, aligned.max)
    return (str(aligned.count), *(f"{1e3 * value:.2f}" for value in values))


def _details(result: SessionResult) -> list[str]:
    session = result.session
    left_out = len(session.used) - int(session.used.sum())
    rows = [("rows", f"{len(session.used)}, of which {left_out} left out")]
    held_out = session.used & ~session.training
    if held_out.any() and result.alignment is not None:
        fit, tested = result.of(session.fitting), result.of(held_out)
        rows.append(
            (
                "training",
                f"{fit.count} errors, mean {_mm(fit.mean)}; held out {tested.count}, {_mm(tested.mean)}",
            )
        )
    if result.alignment is None:
        return _lines(rows)
    description, alignment = session.description, result.alignment
    turn = np.degrees(rotation_log(alignment.rotation))
    if description.alignment.frame:
        rows.append(
            ("frame", f"turned by ({_three(turn)}) deg, shifted by ({_three(1e3 * alignment.shift)}) mm")
        )
    if description.alignment.point:
        for name, point, spread in zip(
            description.sensor_names, alignment.points, alignment.point_errors, strict=True
        ):
            rows.append(
                (f"point {name}", f"({_three(1e3 * point)}) mm, standard error ({_three(1e3 * spread)}) mm")
            )
    if description.time is not None and description.time.most_delay:
        rows.append(("delay", f"{1e3 * alignment.delay:.1f} ms"))
    if len(description.sensors) > 1:
        for s, name in enumerate(description.sensor_names):
            found = measures(result.aligned[result.evaluated, s])
            rows.append(
                (f"sensor {name}", f"mean {_mm(found.mean)}, rms {_mm(found.rms)}, max {_mm(found.max)}")
            )
    for name, (measured, of_model) in result.rest_values().items():
        away = 1e3 * (of_model - measured)
        rows.append((f"at rest {name}", f"model minus measured ({_three(away)}) mm"))
    for name, (measured_ring, model_ring) in result.ringings().items():
        text = ", ".join(
            f"{words} {ring.frequency:.2f} Hz and damping ratio {ring.damping:.3f}"
            for words, ring in (("measured", measured_ring), ("model", model_ring))
        )
        rows.append((f"rings {name}", text))
    if session.times is None:
        for region, (begin, end, found) in result.regions.items():
            text = f"{1e3 * begin:.1f} to {1e3 * end:.1f} mm: mean {_mm(found.mean)} of {found.count}"
            rows.append((region, text))
        for row, s, error in worst(result, SHOWN_WORST):
            where = f"line {session.table.lines[row]}, {description.sensor_names[s]}"
            rows.append(
                ("worst", f"{where}: {_mm(float(np.linalg.norm(error)))}, ({_three(1e3 * error)}) mm")
            )
    rows += [("note", warning) for warning in result.warnings]
    return _lines(rows)


def _lines(rows: Sequence[tuple[str, str]]) -> list[str]:
    width = max(len(name) for name, _ in rows)
    return [f"  {name:<{width}}  {value}" for name, value in rows]


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.2f} mm"


def _three(values: object) -> str:
    return ", ".join(f"{value:.2f}" for value in np.asarray(values, dtype=float).tolist())


STYLE: Final = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 84rem; margin: 1rem auto; padding: 0 1rem;
  color: #222 }
h1 { font-size: 1.5rem; margin: 0 0 .3rem } h2 { font-size: 1rem; margin: .6rem 0 .2rem }
p { margin: .15rem 0; color: #555 } table { border-collapse: collapse; font-size: .87rem }
td, th { padding: .1rem .9rem .1rem 0; text-align: left }
table.numbers td:not(:first-child), table.numbers th:not(:first-child) { text-align: right }
table.numbers td.beyond { color: #b00020; text-align: left !important }
.row { display: flex; gap: 1.5rem; flex-wrap: wrap } figure { margin: 0; width: 47.5rem }
canvas { border: 1px solid #ccc; touch-action: none; cursor: grab }
figcaption { font-size: .85rem; color: #555 }
nav { margin: .5rem 0 .2rem } nav button { font: inherit; padding: .15rem .6rem; margin-right: .3rem }
nav button.on { background: #234; color: #fff } #worst tr { cursor: pointer } #worst tr:hover, #worst tr.on
{ background: #fe9 } svg { width: 420px; height: 150px }
pre { white-space: pre-wrap; max-width: 28rem; margin: .3rem 0 }
"""

SCRIPT: Final = """
'use strict';
const sessions = JSON.parse(document.getElementById('data').textContent).sessions;
const get = id => document.getElementById(id);
let now = 0, chosen = -1, turn = 0.6, tilt = 0.45, zoom = 1, projected = [];
const size = e => Math.hypot(e[0], e[1], e[2]);
function colour(part) {  // blue, green, yellow, red
  const p = Math.max(0, Math.min(1, part));
  return `hsl(${Math.round(230 - 230 * p)} 85% ${45 + 5 * p}%)`;
}
function cells(table, rows) {
  table.replaceChildren(...rows.map(row => {
    const line = document.createElement('tr');
    for (const each of row) {
      const cell = document.createElement('td'); cell.textContent = each; line.append(cell);
    }
    return line;
  }));
}
function draw() {
  const s = sessions[now], canvas = get('field'), pen = canvas.getContext('2d');
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
  for (let k = 0; k <= 100; k++) {
    pen.fillStyle = colour(k / 100); pen.fillRect(12 + 1.6 * k, canvas.height - 22, 2, 10);
  }
  pen.fillStyle = '#333'; pen.fillText(`0 to ${most.toFixed(2)} mm`, 180, canvas.height - 12);
}
function choose(k) {
  const s = sessions[now]; chosen = k;
  [...get('worst').rows].forEach((row, n) => row.classList.toggle('on', s.worst[n] === k));
  const e = s.errors[k], three = v => v.map(c => c.toFixed(2)).join(', ');
  get('chosen').textContent = `${s.labels[k]}: ${size(e).toFixed(2)} mm\\n` +
    `model minus measured: ${three(e)} mm\\n` +
    `measured at: ${three(s.places[k])} mm\\n${s.commands[k]}`;
  draw();
}
function show(n) {
  now = n; chosen = -1;
  const s = sessions[n];
  [...get('sessions').children].forEach((b, k) => b.classList.toggle('on', k === n));
  get('note').textContent = s.note;
  get('chosen').textContent = 'Click a line or a point.';
  const top = Math.max(...s.counts, 1), last = s.edges[s.edges.length - 1];
  const wide = 400 / s.counts.length;
  get('histogram').innerHTML = s.counts.map((c, k) => `<rect x="${10 + k * wide}"` +
    ` y="${130 - 120 * c / top}" width="${wide - 1}" height="${120 * c / top}"` +
    ` fill="${colour((s.edges[k] + s.edges[k + 1]) / 2 / last)}">` +
    `<title>${c} from ${s.edges[k].toFixed(2)} to ${s.edges[k + 1].toFixed(2)} mm</title></rect>`).join('') +
    `<text x="10" y="147" font-size="12">${s.edges[0].toFixed(2)}</text>` +
    `<text x="410" y="147" font-size="12" text-anchor="end">${last.toFixed(2)} mm</text>`;
  cells(get('worst'), s.worst.map(k => [`${size(s.errors[k]).toFixed(2)} mm`, s.labels[k]]));
  [...get('worst').rows].forEach((row, k) => row.onclick = () => choose(s.worst[k]));
  cells(get('regions'),
    s.regions.map(r => [r[0], r[1] + ' mm', r[2] + ' errors', 'mean ' + r[3].toFixed(2) + ' mm']));
  cells(get('alignment'), s.alignment);
  draw();
}
if (sessions.length) {
  get('sessions').replaceChildren(...sessions.map((s, n) => {
    const button = document.createElement('button');
    button.textContent = s.name; button.onclick = () => show(n);
    return button;
  }));
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
  show(0);
}
"""


MOST_POINTS = 4000
"""Largest number of drawn errors of a session; of more, an evenly spaced selection is drawn."""

MOST_WORST = 8
BINS = 30

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>{title}</title>
<style>{style}</style>
<h1>{title}</h1>
{body}
<script id="data" type="application/json">{data}</script>
<script>{script}</script>
</html>
"""


def write(
    file: Path, description: DataSetDescription, model: str | None, results: Sequence[SessionResult]
) -> None:
    """Write the page.

    Raises:
        DataError: the file cannot be written.
    """
    try:
        write_file(file, page(description, model, results))
    except OSError as error:
        raise DataError(file, "", f"cannot be written ({error.strerror})") from error


def page(description: DataSetDescription, model: str | None, results: Sequence[SessionResult]) -> str:
    """Return the page as HTML."""
    asked = [each for each in results if each.alignment is not None]
    details = [("measured by", description.source), ("licence", description.licence)]
    lines = "".join(f"<p><b>{name}</b> {escape(text)}</p>" for name, text in details if text)
    parts = [f"<p>{escape(description.about)}</p>", lines, _html_table(results, asked)]
    if asked:
        parts.append(_VIEW)
    data = json.dumps({"sessions": [_points(each) for each in asked]}, allow_nan=False)
    title = f"{description.name}: model {model}" if model else f"{description.name}: other models"
    return PAGE.format(
        title=escape(title),
        style=STYLE,
        body="\n".join(parts),
        data=data.replace("<", "\\u003c"),
        script=SCRIPT,
    )


_VIEW = """
<nav id="sessions"></nav>
<p id="note"></p>
<div class="row">
  <figure><canvas id="field" width="760" height="480"></canvas>
    <figcaption>Where it was measured, coloured by the error; lines are the errors,
      <input id="length" type="range" min="0" max="20" value="5"> <span id="times"></span> as long.
      Drag to turn, wheel to come nearer.</figcaption></figure>
  <div>
    <h2>Errors</h2><svg id="histogram" viewBox="0 0 420 150"></svg>
    <h2>Worst</h2><table id="worst"></table>
    <pre id="chosen">Click a line or a point.</pre>
  </div>
</div>
<div class="row"><div><h2>By region</h2><table id="regions"></table></div>
<div><h2>Alignment</h2><table id="alignment"></table></div></div>
"""


def _html_table(results: Sequence[SessionResult], asked: Sequence[SessionResult]) -> str:
    head = ("session", "errors", "raw mean", "mean", "rms", "p95", "max", "")
    rows = []
    for each in results:
        name, evaluated = each.session.name, each.evaluated
        if each.alignment is not None:
            verdict = "; ".join(each.beyond)
            rows.append(_row(name, each.of(evaluated), each.of(evaluated, raw=True), verdict))
        for other, errors in each.others.items():
            counted = each.session.evaluated
            found = measures(errors.aligned[counted]), measures(errors.raw[counted])
            rows.append(_row(f"{name}, {other} *", *found, ""))
    if len(asked) > 1:
        raw = measures(np.concatenate([each.raw[each.evaluated].reshape(-1, 3) for each in asked]))
        rows.append(_row("all", summary(asked), raw, ""))
    cells = "".join(f"<th>{name}" for name in head)
    caption = "Errors in mm, model minus measurement, aligned as described; raw: with nothing fitted."
    stars = " * another model, with a rigid frame of its own." if any(each.others for each in results) else ""
    return f"<table class=numbers><tr>{cells}{''.join(rows)}</table><p>{caption}{stars}</p>"


def _row(name: str, aligned: Measures, raw: Measures, verdict: str) -> str:
    values = (raw.mean, aligned.mean, aligned.rms, aligned.p95, aligned.max)
    cells = "".join(f"<td>{1e3 * value:.2f}" for value in values)
    said = f"<td class=beyond>{escape(verdict)}" if verdict else "<td>"
    return f"<tr><td>{escape(name)}<td>{aligned.count}{cells}{said}"


def _points(result: SessionResult) -> dict[str, Any]:
    """Return the data that the page draws of a session, in mm."""
    session = result.session
    assert result.alignment is not None
    rows, sensors = np.nonzero(np.repeat(result.evaluated[:, None], result.aligned.shape[1], axis=1))
    errors = 1e3 * result.aligned[rows, sensors]
    lengths = np.linalg.norm(errors, axis=1)
    names = session.description.sensor_names
    ends = [(session.table.lines[k], names[s]) for k, s in zip(rows.tolist(), sensors.tolist(), strict=True)]
    index = {(int(k), int(s)): n for n, (k, s) in enumerate(zip(rows, sensors, strict=True))}
    drawn = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), MOST_POINTS)).astype(int)).tolist()
    top = [index[k, s] for k, s, _ in worst(result, MOST_WORST)]
    shown = sorted({*drawn, *top})
    at = {n: place for place, n in enumerate(shown)}
    counts, edges = np.histogram(lengths, bins=BINS)
    return {
        "name": session.name,
        "note": " ".join([session.description.note, *result.warnings]),
        "places": (1e3 * result.positions[rows, sensors] - errors)[shown].round(4).tolist(),
        "errors": errors[shown].round(4).tolist(),
        "labels": [f"line {line}, {sensor}" for line, sensor in (ends[n] for n in shown)],
        "commands": [_commands(result, int(rows[n])) for n in shown],
        "worst": [at[n] for n in top],
        "counts": counts.tolist(),
        "edges": edges.round(5).tolist(),
        "regions": [
            [name, f"{1e3 * low:.1f} to {1e3 * high:.1f}", found.count, round(1e3 * found.mean, 3)]
            for name, (low, high, found) in result.regions.items()
            if found.count
        ],
        "alignment": _alignment(result),
    }


def _commands(result: SessionResult, row: int) -> str:
    session = result.session
    texts = [] if session.times is None else [f"t = {session.times[row]:.3f} s"]
    if (columns := session.description.commands) is not None:
        texts += [f"{name} = {session.table.columns[name][row]}" for name in columns.columns]
    return ", ".join(texts)


def _alignment(result: SessionResult) -> list[list[str]]:
    alignment, described = result.alignment, result.session.description
    assert alignment is not None

    def three(values: Any, factor: float = 1e3) -> str:
        return ", ".join(f"{factor * value:.2f}" for value in np.asarray(values).tolist())

    rows = []
    if described.alignment.frame:
        turns = "; ".join(three(row, 1.0) for row in alignment.rotation)
        rows += [["rotation of the data's frame", turns], ["its shift in mm", three(alignment.shift)]]
    if described.alignment.point:
        for name, point, spread in zip(
            described.sensor_names, alignment.points, alignment.point_errors, strict=True
        ):
            rows.append([f"point of {name} in mm", f"{three(point)} (standard errors {three(spread)})"])
    if described.time is not None:
        rows.append(["delay in ms", f"{1e3 * alignment.delay:.1f}"])
    return rows or [["nothing is fitted", ""]]
