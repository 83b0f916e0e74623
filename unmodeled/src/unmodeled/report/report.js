"use strict";
// Motions of a report: zoom, pan, other records, and the model without some of its changes.
const $ = (id) => document.getElementById(id);

const motions = (data) => {
  const NS = $("chart").namespaceURI;
  const COLORS = { measured: "#222222", asis: "#E69F00", with: "#0072B2" };
  let shown = 0, window_ = null, off = new Set();

  const el = (parent, name, attributes, text) => {
    const e = parent.appendChild(document.createElementNS(NS, name));
    for (const k in attributes) e.setAttribute(k, attributes[k]);
    if (text !== undefined) e.textContent = text;
    return e;
  };
  const alternative = () =>
    data.alternatives.findIndex((a) => a.kept.every((kept, i) => kept !== off.has(i)));
  const curves = (k) => {
    const m = data.motions[k], a = off.size ? alternative() : -1;
    return { t: m.t, measured: m.measured, asis: m.asis,
             with: a < 0 ? m.with : data.alternatives[a].curves[k] };
  };

  // Round numbers in an interval.
  const ticks = (low, high, count) => {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= raw * 0.7);
    const out = [];
    for (let i = Math.ceil(low / step); i * step <= high; i++) out.push(i * step);
    return [out, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
  };
  const range = (lists) => {
    let low = Infinity, high = -Infinity;
    for (const y of lists) for (const v of y) if (v !== null) {
      if (v < low) low = v;
      if (v > high) high = v;
    }
    return [low, high];
  };
  // Ends of the vertical axis: the record, and the models as far as they are near it. They do not
  // follow the changes.
  const limits = (k, inside) => {
    const c = data.motions[k];
    const cut = (y) => y.filter((_, i) => inside(c.t[i]));
    const [a, b] = range([cut(c.measured)]);
    if (!isFinite(a)) return [0, 1];
    const [low, high] = range([cut(c.measured), cut(c.asis), cut(c.with)]);
    const room = 0.6 * (b - a) || 1;
    const ends = [Math.max(low, a - room), Math.min(high, b + room)];
    const margin = 0.05 * (ends[1] - ends[0]) || 1;
    return [ends[0] - margin, ends[1] + margin];
  };
  const path = (t, y, x, to) => {
    let d = "", pen = "M";
    for (let i = 0; i < t.length; i++) {
      if (y[i] === null) { pen = "M"; continue; }
      d += pen + x(t[i]).toFixed(1) + " " + to(y[i]).toFixed(1);
      pen = "L";
    }
    return d;
  };

  let clips = 0;
  // One panel: axes and curves; returns the scale of the time.
  const panel = (svg, box, c, lines, span, ylim, label, last) => {
    const [left, top, width, height] = box;
    const x = (t) => left + (width * (t - span[0])) / (span[1] - span[0] || 1);
    const to = (v) => top + height * (1 - (v - ylim[0]) / (ylim[1] - ylim[0]));
    const id = `clip${clips++}`;
    el(el(svg, "clipPath", { id }), "rect", { x: left, y: top, width, height });
    const [ys, yd] = ticks(ylim[0], ylim[1], Math.max(4, height / 45));
    for (const v of ys) {
      el(svg, "line", { x1: left, x2: left + width, y1: to(v), y2: to(v), class: "grid" });
      el(svg, "text", { x: left - 6, y: to(v) + 4, "text-anchor": "end" }, v.toFixed(yd));
    }
    const [xs, xd] = ticks(span[0], span[1], Math.max(2, width / 90));
    for (const v of xs) {
      el(svg, "line", { x1: x(v), x2: x(v), y1: top, y2: top + height, class: "grid" });
      if (last) el(svg, "text", { x: x(v), y: top + height + 16, "text-anchor": "middle" }, v.toFixed(xd));
    }
    el(svg, "text", { x: 2, y: top - 6 }, label);
    const g = el(svg, "g", { "clip-path": `url(#${id})` });
    for (const [y, color, w, dash, opacity] of lines)
      el(g, "path", { d: path(c.t, y, x, to), stroke: color, "stroke-width": w, fill: "none",
                      "stroke-dasharray": dash || "none", opacity: opacity || 1 });
    return x;
  };

  let scale = null;
  const draw = () => {
    const svg = $("chart"), m = data.motions[shown], c = curves(shown);
    const width = svg.parentNode.clientWidth, small = width < 600;
    if (width < 80) return;
    const height = small ? 210 : 270, rest = small ? 70 : 90, left = 52;
    const whole = [c.t[0], c.t[c.t.length - 1]], span = window_ || whole;
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${width} ${height + rest + 90}`);
    svg.setAttribute("height", height + rest + 90);
    const inside = (t) => t >= span[0] && t <= span[1];
    const lines = [
      [c.asis, COLORS.asis, 1.8, "6 3"],
      [c.measured, COLORS.measured, 4, "", 0.3],
      [c.with, COLORS.with, 1.8, "4 2"],
    ];
    const box = [left, 24, width - left - 12, height];
    scale = { x: panel(svg, box, c, lines, span, limits(shown, inside), `${m.channel}${m.unit}`, false),
              left, width: box[2], span, whole };
    const less = (y) => y.map((v, i) => (v === null || c.measured[i] === null ? null : c.measured[i] - v));
    const leaves = [less(c.asis), less(c.with)];
    const largest = (y) => Math.max(0, ...y.filter((v, i) => v !== null && inside(c.t[i])).map(Math.abs));
    const [a, b] = range([c.measured]), rests = largest(leaves[1]);
    const most = 1.1 * Math.max(rests, Math.min(largest(leaves[0]), 6 * rests), 0.05 * (b - a), 1e-12);
    panel(svg, [left, height + 54, box[2], rest], c,
          [[leaves[0], COLORS.asis, 1.4, "6 3"], [leaves[1], COLORS.with, 1.4]],
          span, [-most, most], "measured − model", true);
    el(svg, "text", { x: width - 12, y: height + rest + 86, "text-anchor": "end" }, `time${m.clock}`);
    $("which").textContent = m.title;
    numbers();
    document.querySelectorAll("#records button").forEach((b, k) =>
      b.setAttribute("aria-pressed", k + 1 === shown));
  };

  const numbers = () => {
    const m = data.motions[shown], a = alternative();
    if (a < 0 || !data.alternatives.length) return;
    const left = data.alternatives[a].left[m.channel];
    const text = left === null ? "The simulation fails"
      : `Left of ${m.channel} in all records: ${left} of its motion`;
    $("left").textContent = off.size ? `${text}, simulated with the other sizes as they are, not fitted again.` : `${text}.`;
  };

  // ------------------------------------------------------------------ zoom, pan
  const look = (from, to) => {
    const [a, b] = scale.whole, least = (b - a) / 400;
    if (to - from < least) return;
    if (from < a) { to += a - from; from = a; }
    if (to > b) { from -= to - b; to = b; }
    window_ = to - from >= b - a ? null : [Math.max(from, a), to];
    draw();
  };
  const zoom = (factor, at) => {
    const [a, b] = scale.span, center = at === undefined ? (a + b) / 2 : at;
    look(center - (center - a) * factor, center + (b - center) * factor);
  };
  const pan = (share) => {
    const [a, b] = scale.span;
    look(a + share * (b - a), b + share * (b - a));
  };
  const time = (event) => {
    const r = $("chart").getBoundingClientRect();
    const share = (event.clientX - r.left - scale.left) / scale.width;
    return scale.span[0] + share * (scale.span[1] - scale.span[0]);
  };
  const chart = $("chart");
  let grabbed = null;
  chart.addEventListener("wheel", (e) => {
    if (!e.ctrlKey && !e.shiftKey) return;
    e.preventDefault();
    zoom(e.deltaY > 0 ? 1.25 : 0.8, time(e));
  }, { passive: false });
  chart.addEventListener("pointerdown", (e) => { grabbed = time(e); chart.setPointerCapture(e.pointerId); });
  chart.addEventListener("pointermove", (e) => {
    if (grabbed === null || !window_) return;
    const by = grabbed - time(e);
    look(scale.span[0] + by, scale.span[1] + by);
  });
  chart.addEventListener("pointerup", () => { grabbed = null; });
  chart.addEventListener("dblclick", (e) => zoom(0.5, time(e)));
  const steps = { in: () => zoom(0.5), out: () => zoom(2), back: () => pan(-0.4),
                  on: () => pan(0.4), all: () => { window_ = null; draw(); } };
  for (const name in steps) $(`zoom-${name}`).addEventListener("click", steps[name]);
  chart.addEventListener("keydown", (e) => {
    const key = { "+": "in", "-": "out", ArrowLeft: "back", ArrowRight: "on", "0": "all" }[e.key];
    if (!key) return;
    e.preventDefault();
    steps[key]();
  });

  // ------------------------------------------------------------------ changes and records
  const boxes = [...document.querySelectorAll("#changes input")];
  boxes.forEach((box, i) => box.addEventListener("change", () => {
    if (!data.all && !box.checked) {  // only one at a time was simulated
      off = new Set();
      boxes.forEach((b) => { b.checked = b === box ? false : true; });
    }
    if (box.checked) off.delete(i); else off.add(i);
    draw();
    smalls();
  }));
  const smalls = () => document.querySelectorAll("#records svg").forEach((svg, i) => {
    const k = i + 1, c = curves(k), span = [c.t[0], c.t[c.t.length - 1]];
    const ylim = limits(k, () => true);
    const x = (t) => 2 + (146 * (t - span[0])) / (span[1] - span[0] || 1);
    const to = (v) => 48 - (46 * (v - ylim[0])) / (ylim[1] - ylim[0]);
    svg.replaceChildren();
    for (const [y, color, w, opacity] of [[c.asis, COLORS.asis, 1, 1], [c.measured, COLORS.measured, 2.4, 0.3],
                                          [c.with, COLORS.with, 1, 1]])
      el(svg, "path", { d: path(c.t, y, x, to), stroke: color, "stroke-width": w, fill: "none", opacity });
  });
  document.querySelectorAll("#records button").forEach((b, i) => b.addEventListener("click", () => {
    shown = shown === i + 1 ? 0 : i + 1;
    window_ = null;
    draw();
    chart.scrollIntoView({ block: "nearest" });
  }));
  smalls();
  draw();
  addEventListener("resize", draw);
};

// Table of the candidates: rows that have all words.
const table = () => {
  const search = $("find");
  if (!search) return;
  search.addEventListener("input", () => {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    let count = 0;
    document.querySelectorAll("#candidates tbody tr").forEach((row) => {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every((w) => text.includes(w));
      count += !row.hidden;
    });
    $("found").textContent = `${count} found`;
  });
};

document.body.classList.add("alive");
if ($("motions")) motions(JSON.parse($("motions").textContent));
table();
