"use strict";
// The page of a diagnosis. The server keeps model, files and search; the page keeps the form.
const $ = (id) => document.getElementById(id);
let state = { model: null, files: [], search: { running: false }, result: [] };
const columns = new Map(); // name of a column -> {channel, unit}
const held = new Set(); // files that are only predicted

const make = (parent, name, attributes = {}, text) => {
  const space = parent.namespaceURI.endsWith("svg") || name === "svg" ? "http://www.w3.org/2000/svg" : parent.namespaceURI;
  const e = parent.appendChild(document.createElementNS(space, name));
  for (const k in attributes) e.setAttribute(k, attributes[k]);
  if (text !== undefined) e.textContent = text;
  return e;
};

// --- the server ----------------------------------------------------------------------------------

const fault = (text) => {
  $("fault").textContent = text;
  $("fault").hidden = !text;
  if (text) $("fault").scrollIntoView({ block: "nearest" });
};
// One request; a fault is told on the page, and the result is then undefined.
const ask = async (path, options = {}) => {
  try {
    const answer = await fetch(path, options);
    if (!answer.ok) throw new Error(await answer.text());
    return await answer.json();
  } catch (error) {
    fault(error instanceof TypeError ? "The server does not answer; start it again: unmodeled page" : error.message);
  }
};
const post = (path, value) => ask(path, { method: "POST", body: JSON.stringify(value) });
const lines = (id) => $(id).value.split("\n").map((t) => t.trim()).filter(Boolean);
const form = () => ({
  files: state.files.map((f) => f.file),
  columns: Object.fromEntries(present().filter((c) => columns.has(c)).map((c) => [c, columns.get(c)])),
  parameter: lines("parameter"),
  unknown: lines("unknown"),
  hold_out: [...held].filter((k) => state.files.some((f) => f.file === k)),
  good_enough: $("good").value.split(",").map((t) => t.trim()).filter(Boolean),
  seconds: Number($("seconds").value) || 0,
});
const present = () => [...new Set(state.files.flatMap((f) => f.columns.map((c) => c[0])))];

// --- model and files -----------------------------------------------------------------------------

const upload = async (path, files) => {
  fault("");
  for (const file of files)
    if (!(await ask(`${path}?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file }))) break;
  $("checked").replaceChildren();
  await refresh();
};
const droppable = (area, input, path) => {
  const mark = (on) => (event) => { event.preventDefault(); area.classList.toggle("over", on); };
  area.addEventListener("dragover", mark(true));
  area.addEventListener("dragleave", mark(false));
  area.addEventListener("drop", (event) => { mark(false)(event); upload(path, event.dataTransfer.files); });
  input.addEventListener("change", async () => { await upload(path, [...input.files]); input.value = ""; });
};
droppable($("drop-model"), $("model-file"), "model");
droppable($("drop-records"), $("record-files"), "records");
for (const kind of ["dragover", "drop"]) // a file beside the areas would replace the page
  addEventListener(kind, (event) => event.preventDefault());

const showModel = () => {
  const m = state.model;
  $("priors").replaceChildren();
  for (const p of document.querySelectorAll(".states")) p.hidden = !m || !m.states;
  if (!m) return;
  const few = (names) => (names.length > 8 ? `${names.slice(0, 8).join(", ")}, … (${names.length})` : names.join(", ")) || "those of the records";
  $("model").textContent = `${m.name}. Inputs: ${few(m.inputs)}. Outputs: ${few(m.outputs)}.`;
  if (m.known.length) {
    const more = make($("priors"), "details");
    make(more, "summary", {}, "Names of the parameters of the model");
    make(more, "p", { class: "soft" }, m.known.map(([name, unit]) => (unit === "1" ? name : `${name} [${unit}]`)).join(", "));
  }
  if (!m.parameters.length) return;
  const table = make($("priors"), "table");
  make(table, "caption", { class: "soft" }, "Parameters with their priors");
  const head = make(table, "tr");
  for (const t of ["parameter", "value", "standard deviation", "unit"]) make(head, "th", { scope: "col" }, t);
  for (const [name, value, sd, unit] of m.parameters) {
    const row = make(table, "tr");
    make(row, "td", {}, name);
    make(row, "td", { class: "number" }, String(+value.toPrecision(5)));
    make(row, "td", { class: "number" }, sd === null ? "not known" : String(+sd.toPrecision(3)));
    make(row, "td", {}, unit);
  }
};

const showFiles = () => {
  $("files").replaceChildren();
  for (const f of state.files) {
    const row = make($("files"), "li", {}, `${f.name} `);
    const label = make(row, "label");
    const box = make(label, "input", { type: "checkbox" });
    box.checked = held.has(f.file);
    box.addEventListener("change", () => (box.checked ? held.add(f.file) : held.delete(f.file)));
    label.append(" only predicted, not fitted ");
    const button = make(row, "button", { "aria-label": `Remove ${f.name}` }, "Remove");
    button.addEventListener("click", async () => { await ask(`records/${f.file}`, { method: "DELETE" }); await refresh(); });
  }
  showColumns();
};

const showColumns = () => {
  const area = $("columns"), m = state.model;
  area.replaceChildren();
  area.hidden = !m || !state.files.length;
  if (area.hidden) return;
  const units = new Map(state.files.flatMap((f) => f.columns));
  const channels = ["time", ...m.inputs, ...m.outputs];
  const table = make(area, "table");
  make(table, "caption", { class: "soft" }, "Columns and channels of the model");
  const head = make(table, "tr");
  for (const t of ["column", "channel", "unit"]) make(head, "th", { scope: "col" }, t);
  for (const name of present()) {
    const row = make(table, "tr"), given = columns.get(name) || { channel: "", unit: "" };
    const keep = (change) => {
      columns.set(name, Object.assign(given, change));
      if (!given.channel && !given.unit) columns.delete(name);
    };
    make(row, "td", {}, name);
    const select = make(make(row, "td"), "select", { "aria-label": `Channel of column ${name}` });
    make(select, "option", { value: "" }, channels.includes(name) ? `${name} (its name)` : "by its name, or not used");
    for (const c of channels) if (c !== name) make(select, "option", { value: c }, c);
    select.value = given.channel;
    select.addEventListener("change", () => keep({ channel: select.value }));
    const unit = make(make(row, "td"), "input", { class: "unit", "aria-label": `Unit of column ${name}`, placeholder: units.get(name) || "unit", spellcheck: "false" });
    unit.value = given.unit;
    unit.addEventListener("change", () => keep({ unit: unit.value.trim() }));
  }
};

// --- check ---------------------------------------------------------------------------------------

const ends = (lists) => {
  const all = lists.flat().filter((v) => v !== null);
  const low = Math.min(...all), high = Math.max(...all), room = 0.05 * (high - low) || 1;
  return all.length ? [low - room, high + room] : [0, 1];
};
// Round numbers in an interval, and their digits after the point.
const ticks = (low, high, count) => {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= raw * 0.7);
  const out = [];
  for (let i = Math.ceil(low / step); i * step <= high; i++) out.push(i * step);
  return [out, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
};
const picture = (area, record, channel) => {
  const figure = make(area, "figure");
  make(figure, "figcaption", {}, `${channel.name} of ${record.name}`);
  const [width, height, left, top, low] = [480, 200, 56, 18, 32];
  const svg = make(figure, "svg", { viewBox: `0 0 ${width} ${height}`, role: "img",
    "aria-label": `${channel.name} of ${record.name}: measured, and the model as it is, over time` });
  const t = record.time, [a, b] = [t[0], t[t.length - 1]], [y0, y1] = ends([channel.measured, channel.model]);
  const x = (v) => left + ((width - left - 12) * (v - a)) / (b - a || 1);
  const y = (v) => top + (height - top - low) * (1 - (v - y0) / (y1 - y0));
  const [ys, yd] = ticks(y0, y1, 4), [xs, xd] = ticks(a, b, 5);
  for (const v of ys) {
    make(svg, "line", { x1: left, x2: width - 12, y1: y(v), y2: y(v), class: "grid" });
    make(svg, "text", { x: left - 5, y: y(v) + 4, "text-anchor": "end" }, v.toFixed(yd));
  }
  for (const v of xs) make(svg, "text", { x: x(v), y: height - low + 14, "text-anchor": "middle" }, v.toFixed(xd));
  make(svg, "text", { x: 2, y: 11 }, channel.unit && channel.unit !== "1" ? `[${channel.unit}]` : "");
  make(svg, "text", { x: width - 12, y: height - 3, "text-anchor": "end" }, "time [s]");
  for (const [values, kind] of [[channel.measured, "measured"], [channel.model, "asis"]]) {
    let d = "", pen = "M";
    values.forEach((v, i) => {
      if (v === null) { pen = "M"; return; }
      d += `${pen}${x(t[i]).toFixed(1)} ${y(v).toFixed(1)}`;
      pen = "L";
    });
    make(svg, "path", { d, class: kind });
  }
};
const showCheck = (found) => {
  const area = $("checked");
  area.replaceChildren();
  for (const text of found.hints) make(area, "p", { class: "hint" }, text);
  const key = make(area, "p", { class: "key" });
  for (const [kind, text] of [["", "measured"], ["model", "the model as it is"]]) { make(key, "i", { class: kind }); key.append(text); }
  const pictures = make(area, "div", { class: "pictures" });
  for (const r of found.records) for (const c of r.channels) picture(pictures, r, c);
  const table = make(make(area, "div", { class: "wide" }), "table"), head = make(table, "tr");
  for (const t of ["record", "channel", "difference (rms)", "in noise"]) make(head, "th", { scope: "col" }, t);
  for (const r of found.rows) {
    const row = make(table, "tr");
    make(row, "td", {}, r.record);
    make(row, "td", {}, r.channel);
    make(row, "td", { class: "number" }, `${+r.rms.toPrecision(3)} ${r.unit === "1" ? "" : r.unit}`);
    make(row, "td", { class: "number" }, r.noise === null ? "" : String(+r.noise.toPrecision(2)));
  }
  if (found.notes.length) {
    const list = make(area, "ul");
    for (const text of found.notes) make(list, "li", {}, text);
  }
};
$("check").addEventListener("click", async () => {
  fault("");
  $("check").disabled = true;
  const found = await post("check", form());
  $("check").disabled = false;
  if (found) showCheck(found);
});

// --- search --------------------------------------------------------------------------------------

const duration = (s) => (s < 100 ? `${Math.round(s)} s` : `${Math.floor(s / 60)}:${String(Math.round(s) % 60).padStart(2, "0")} min`);
let timer = 0, shown = "";
const showSearch = () => {
  const s = state.search;
  $("search").disabled = s.running;
  $("stop").hidden = $("progress").hidden = !s.running;
  $("answer").hidden = s.running || !state.result.length;
  clearTimeout(timer);
  if (s.running) {
    $("bar").value = s.share;
    const left = s.left === null ? "" : `, about ${duration(s.left)} left`;
    $("stage").textContent = `The search ${s.stage}, ${Math.round(100 * s.share)} %${left}`;
    shown = "";
    timer = setTimeout(refresh, 400);
  } else if (state.result.length && shown !== state.result.join()) {
    shown = state.result.join();
    $("report").src = `result/report.html?${Date.now()}`;
    $("exports").replaceChildren();
    const link = (name, text) => {
      make($("exports"), "a", { href: `result/${name}?save`, download: name }, text);
      $("exports").append(" · ");
    };
    link("report.html", "Save the report");
    for (const n of state.result.filter((n) => n.startsWith("remedy"))) link(n, `Save the remedy (${n})`);
    link("case.zip", "Save the case (model, records, options, answer)");
    make($("exports"), "a", { href: "result/report.html", target: "_blank", rel: "noopener" }, "Open the report in its own tab");
    $("answer").scrollIntoView();
  }
  if (s.fault) fault(s.fault);
};
$("search").addEventListener("click", async () => {
  fault("");
  $("search").disabled = true;
  await post("search", form());
  await refresh();
});
$("stop").addEventListener("click", () => { $("stage").textContent = "The search stops"; post("stop", {}); });

const refresh = async () => {
  const found = await ask("state");
  if (!found) return;
  const same = (key) => JSON.stringify(found[key]) === JSON.stringify(state[key]);
  const [model, files] = [same("model"), same("files")];
  state = found;
  if (!model) showModel();
  if (!model || !files) showFiles();
  showSearch();
};
showModel();
refresh();
