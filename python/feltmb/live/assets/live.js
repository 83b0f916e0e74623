// The live page: it owns what is turned and played, and a transport takes it to what computes: `Line` to
// the server, or `Local` (local.js) to a worker. Texts of files become text nodes only, never markup.

const FIRST = {kind: "packaged", name: "forte", force: 5, speed: 0.2, travel: 0.012, rate: 6, count: 3, duration: 0.5,
  drawn: "force", time: [], value: []};
const READER = {m: [1e3, "mm"], rad: [180 / Math.PI, "deg"], "1": [100, "%"], s: [1e3, "ms"]};
const FELT = 2;  // forces that a hand feels before the key bottom [N]
const COLOR = {get a() { return PAINT.runs[0]; }, get b() { return PAINT.runs[1]; }};

const copyOf = thing => JSON.parse(JSON.stringify(thing));
const round = (x, digits = 4) => Number.isFinite(x) ? String(+x.toPrecision(digits)) : "–";
const button = (text, onclick, options = {}) =>
  element("button", {type: "button", onclick, ...options}, text);
const find = id => document.getElementById(id);

// ---------------------------------------------------------------- state

// What is turned and played; everything that an address reproduces.
class State {
  constructor() {
    this.now = {knobs: {}, numbers: {}, playing: copyOf(FIRST), b: null};
    this.back = [];
    this.ahead = [];
    this.stamp = 0;
    this.read();
  }

  // One entry of the history for each turn of one control, however long it is dragged.
  change(what, edit) {
    const now = performance.now();
    if (what !== this.last || now - this.stamp > 1200) {
      this.back.push(copyOf(this.now));
      if (this.back.length > 200) this.back.shift();
    }
    this.last = what;
    this.stamp = now;
    this.ahead = [];
    edit(this.now);
    this.write();
  }

  step(from, to) {
    if (!from.length) return false;
    to.push(copyOf(this.now));
    this.now = from.pop();
    this.last = null;
    this.write();
    return true;
  }

  write() {
    clearTimeout(this.writing);
    this.writing = setTimeout(() => {
      this.written = "#" + encodeURIComponent(JSON.stringify(this.now));
      history.replaceState(null, "", this.written);
    }, 150);
  }

  read() {
    if (location.hash.length < 2 || location.hash === this.written) return false;
    try {
      const given = JSON.parse(decodeURIComponent(location.hash.slice(1)));
      const turned = t => ({knobs: {...t.knobs}, numbers: {...t.numbers}});
      this.now = {...turned(given), playing: {...FIRST, ...given.playing},
                  b: given.b ? turned(given.b) : null};
      return true;
    } catch { return false; }
  }
}

// ---------------------------------------------------------------- connection

// One WebSocket.
class Line {
  static lacks = new Set();

  constructor(heard, changed) {
    this.heard = heard;
    this.changed = changed;
    this.pause = 300;
    this.open();
  }

  open() {
    const folder = location.pathname.replace(/[^/]*$/, "");
    const socket = this.socket = new WebSocket(`ws://${location.host}${folder}socket`);
    socket.onopen = () => { this.pause = 300; this.changed(true); };
    socket.binaryType = "arraybuffer";
    socket.onmessage = e => this.heard(unpackMessage(e.data));
    socket.onclose = () => {
      this.changed(false);
      setTimeout(() => this.open(), this.pause);
      this.pause = Math.min(5000, 1.6 * this.pause);
    };
  }

  get up() { return this.socket.readyState === 1; }

  send(message) {
    if (!this.up) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  async ask(path, options) {
    const answer = await fetch(path, options);
    if (!answer.ok) throw new Error(await answer.text());
    return answer;
  }

  post(path, body) { return this.ask(path, {method: "POST", body: JSON.stringify(body)}); }

  // The sound of what a message describes.
  async sound(message) {
    const answer = await this.post("sound", message);
    return {wav: await answer.blob(), level: Number(answer.headers.get("X-Level") ?? NaN)};
  }

  // A measured file; what is known of it.
  async add(file) { return (await this.ask("records?name=" + encodeURIComponent(file.name), {method: "POST", body: file})).json(); }

  remove(key) { return fetch("records/" + encodeURIComponent(key), {method: "DELETE"}); }
}

// ---------------------------------------------------------------- page

class Live {
  constructor(Transport) {
    this.has = what => !Transport.lacks.has(what);
    this.state = new State();
    this.id = 0;
    this.got = {a: null, b: null};
    this.looks = {a: null, b: null};  // of the mechanism of the newest whole run
    this.shown = [];
    this.sent = new Map();  // when what a request tells was changed; those without a picture yet
    this.times = [];  // from change to picture [ms], the newest last
    this.tab = "numbers";
    this.build();
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.narrow = matchMedia("(max-width: 700px)");
    this.dark.addEventListener("change", () => this.paint());
    this.narrow.addEventListener("change", () => { this.place(); this.fillTab(); });
    this.paint();
    this.line = new Transport(m => this.hear(m), up => this.connected(up));
    addEventListener("hashchange", () => { if (this.state.read()) this.restored(); });
    addEventListener("keydown", e => this.key(e));
  }

  // -------------------------------------------------------------- talk

  connected(up) {
    this.say(up ? "" : "connection lost, trying again …", !up);
    this.sent.clear();
    if (up && this.hello) this.ask();
  }

  say(text, off = false) {
    put(this.status, text);
    this.status.classList.toggle("off", off);
  }

  hear(m) {
    const take = {hello: this.greeted, run: this.pictured, fault: this.refused, targets: this.lights,
      touch: this.touched, speeds: this.speeded, regulated: this.regulated, progress: this.progressed,
      measured: this.held, diagnosing: this.diagnosing, diagnosis: this.diagnosed, planning: this.planning, plan: this.planned,
      refused: m => this.say(m.text, true)}[m.on];
    if (take) take.call(this, m);
  }

  greeted(m) {
    const other = !this.hello || this.hello.name !== m.name || this.hello.edition !== m.edition;
    this.fileFaults(m.faults);
    if (!m.knobs) return;
    // Files that this page added stay after a lost connection.
    const own = (this.hello?.files || []).filter(f => !m.files.some(g => g.file === f.file));
    this.hello = {...this.hello, ...m, files: [...m.files, ...own]};
    document.title = `${m.name} · feltmb live`;
    this.title.textContent = m.name;
    this.title.title = m.about;
    // Without a finger the machine moves by itself.
    if (!m.strokes.length) this.state.now.playing.kind = "free";
    if (other) { this.looks = {a: m.look, b: m.look}; this.fillTurn(); this.fillPlay(); this.fillTab(); }
    this.ask();
  }

  fileFaults(faults) {
    const box = find("faults");
    box.hidden = !faults.length;
    box.replaceChildren(element("b", {}, `${faults.length} fault${faults.length > 1 ? "s" : ""} in the file; ` +
      "the last mechanism without is shown"),
      element("ul", {}, ...faults.map(f => element("li", {}, f))));
  }

  turned() { return {knobs: this.state.now.knobs, numbers: this.state.now.numbers}; }

  extras() { return {numbers: [], regulation: ["targets"], touch: ["touch"], speeds: ["speeds"]}[this.tab] || []; }

  request(slot) {
    const turned = slot === "b" ? this.state.now.b : this.turned();
    return {do: "simulate", slot, id: ++this.id, turned, playing: this.state.now.playing, until: this.until(),
      shown: this.shown, extras: this.extras().filter(e => slot === "a" || e !== "targets")};
  }

  // While something is turned, pictures end where the motion of the last whole run and the view have ended.
  until() {
    const {viewer, rest, state} = this;
    if (!rest || rest.played !== JSON.stringify(state.now.playing)) return undefined;
    return 1e-3 * Math.max(rest.end, ...viewer.runs.map(r => r.time(viewer.window[1])));
  }

  // Something changed: simulate anew. What computes takes the newest request, when it has ended the one before.
  ask(b = false) {
    this.b ||= b;
    if (this.asking) return;
    this.asking = true;
    queueMicrotask(() => {
      this.asking = false;
      if (!this.hello || !this.line.up) return;
      const asked = this.request("a");
      this.sent.set(asked.id, performance.now());
      this.line.send(asked);
      if (this.b) this.line.send(this.state.now.b ? this.request("b") : {do: "forget"});
      this.b = false;
      if (this.tab === "measured") this.measure();
    });
  }

  pictured(m) {
    const first = !this.viewer, kind = JSON.stringify(this.state.now.playing), {stage} = m.run;
    stage.look = this.looks[m.slot] = stage.look || this.looks[m.slot];
    this.got[m.slot] = {...m.run, set: m.set, name: m.slot === "a" ? "A, turned" : "B, kept"};
    if (m.slot === "b" && !this.state.now.b) this.got.b = null;
    if (first) this.open();
    else this.viewer.replace(this.both(), {look: kind !== this.played});
    this.played = kind;
    if (m.slot === "a" && m.run.quality === "full" && !this.sent.size) this.rest = {played: kind, end: m.run.busy[1]};
    const since = m.slot === "a" && m.run.quality === "quick" ? this.answered(m.id) : [];
    if (since.length) {
      requestAnimationFrame(() => {
        this.times.push(...since.map(t => performance.now() - t));
        this.times.splice(0, this.times.length - 500);
        this.say("");
        this.status.title = `change to picture ${this.times.at(-1).toFixed(0)} ms`;
      });
    }
    if (this.fault) { this.fault = null; this.fileFaults([]); }
    this.showNumbers();
  }

  // When all was changed that a request and those before it told.
  answered(last) {
    const since = [];
    for (const [id, time] of this.sent) if (id <= last) { since.push(time); this.sent.delete(id); }
    return since;
  }

  both() { return [this.got.a, this.got.b].filter(r => r); }

  refused(m) {
    this.answered(m.id);
    this.fault = m.faults;
    const box = find("faults");
    box.hidden = false;
    box.replaceChildren(element("b", {}, "This cannot be simulated"),
      element("ul", {}, ...m.faults.map(f => element("li", {}, f))));
  }

  // -------------------------------------------------------------- structure

  build() {
    this.title = element("h1", {}, "feltmb live");
    this.status = element("span", {class: "state", role: "status"}, "connecting …");
    this.undoButton = button("Undo", () => this.undo(), {title: "Ctrl+Z"});
    this.redoButton = button("Redo", () => this.redo(), {title: "Ctrl+Shift+Z"});
    this.keepButton = button("Keep as B", () => this.keep(), {title: "compare with what is turned now: B"});
    this.swapButton = button("A ⇄ B", () => this.swap(), {title: "X"});
    this.dropButton = button("Drop B", () => this.drop());
    this.hearB = button("Hear B", () => this.hearIt("b"));
    this.hearRest = button("Hear A − B", () => this.hearIt("a", true), {title: "what B changed, at full scale"});
    find("top").append(this.title,
      element("span", {class: "group"}, this.undoButton, this.redoButton,
        button("Reset all", () => this.resetAll())),
      element("span", {class: "group"}, this.keepButton, this.swapButton, this.dropButton),
      element("span", {class: "group"},
        button("Hear", () => this.hearIt("a")), this.hearB, this.hearRest,
        ...this.has("files") ? [button("Save TOML", () => this.save())] : []),
      this.status);
    this.playBar = element("div", {class: "play"});
    this.root = element("div", {tabindex: "0"});
    this.answer = element("p", {class: "answer", role: "status", hidden: ""});
    find("see").append(this.answer, this.playBar, this.root);
    this.tabs = element("div", {class: "tabs", role: "tablist"});
    this.tabBox = element("div", {class: "tab", role: "tabpanel"});
    find("more").append(this.tabs, this.tabBox);
    this.buttons();
  }

  open() {
    this.root.className = "feltmb-view";
    this.viewer = this.root.viewer = new Viewer(this.root, {
      runs: this.both(), slowness: 20, align: "", at: null, title: this.hello.name,
      panels: this.hello.panels.slice(0, 4), known: this.hello.outputs});
    this.viewer.wanted = () => { if (this.wants()) this.ask(true); };
    this.place();
  }

  // On a narrow page the controls follow the mechanism, which stays in sight.
  place() {
    if (!this.viewer) return;
    const turn = find("turn");
    if (this.narrow.matches) this.viewer.left.querySelector(".fv-frame").after(turn);
    else find("main").prepend(turn);
    this.viewer.layout();
  }

  paint() {
    PAINT = this.dark.matches ? NIGHT : DAY;
    if (this.viewer) {
      this.viewer.replace(this.both());
      this.viewer.fillHead();
    }
    this.fillTab();
  }

  // Outputs whose curves are shown anywhere; true if they changed.
  wants() {
    const names = new Set();
    for (const given of this.viewer ? this.viewer.panels : this.hello ? this.hello.panels.slice(0, 4) : [])
      given.outputs.forEach(n => names.add(n));
    if (this.tab === "loops") {
      const n = String(this.loop).padStart(2, "0");
      names.add(`contact${n}.force`).add(`contact${n}.compression`);
    }
    const list = [...names].slice(0, 24), same = list.join() === this.shown.join();
    this.shown = list;
    return !same;
  }

  buttons() {
    const s = this.state;
    this.undoButton.disabled = !s.back.length;
    this.redoButton.disabled = !s.ahead.length;
    this.swapButton.disabled = this.dropButton.disabled = this.hearB.disabled =
      this.hearRest.disabled = !s.now.b;
  }

  change(what, edit, b = false) {
    this.state.change(what, edit);
    this.buttons();
    this.ask(b);
  }

  restored() {
    this.buttons();
    this.fillTurn();
    this.fillPlay();
    this.got.b = this.state.now.b ? this.got.b : null;
    this.ask(true);
  }

  undo() { if (this.state.step(this.state.back, this.state.ahead)) this.restored(); }
  redo() { if (this.state.step(this.state.ahead, this.state.back)) this.restored(); }
  resetAll() { this.change("reset", n => { n.knobs = {}; n.numbers = {}; }); this.fillTurn(); }
  keep() { this.change("keep", n => { n.b = copyOf(this.turned()); }, true); }
  swap() {
    if (!this.state.now.b) return;
    this.change("swap", n => {
      const b = copyOf(n.b);
      n.b = copyOf({knobs: n.knobs, numbers: n.numbers});
      Object.assign(n, b);
    }, true);
    this.fillTurn();
  }
  drop() {
    this.got.b = null;
    this.change("drop", n => { n.b = null; }, true);
  }

  key(e) {
    const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(e.target.tagName) && e.target.type !== "range";
    if ((e.ctrlKey || e.metaKey) && e.key.toLowerCase() === "z" && !typing) {
      e.shiftKey ? this.redo() : this.undo();
      e.preventDefault();
    } else if (!typing && !e.ctrlKey && !e.altKey && !e.metaKey) {
      if (e.key === "/") { find("turn").querySelector("input").focus(); e.preventDefault(); }
      if (e.key === "x") this.swap();
    }
  }

  // -------------------------------------------------------------- turn

  fillTurn() {
    if (!this.hello) return;
    const turn = find("turn"), words = (this.search && this.search.value) || "";
    const open = new Set([...turn.querySelectorAll("details[open]")].map(d => d.dataset.group));
    if (!turn.childElementCount) open.add("screws");
    this.search = element("input", {type: "search", placeholder: "Search: a part, or a path of the file  ( / )",
      "aria-label": "search what can be turned", oninput: () => this.fillFound()});
    this.search.value = words;
    this.found = element("div", {class: "found"});
    this.groups = element("div");
    const groups = new Map();
    for (const knob of this.hello.knobs)
      groups.set(knob.group, [...(groups.get(knob.group) || []), knob]);
    for (const [name, knobs] of groups) {
      const body = element("div"), box = element("details", {}, element("summary", {}, name + " ",
        element("span", {class: "count"}, String(knobs.length))), body);
      box.dataset.group = name;
      const fill = () => { if (box.open && !body.childElementCount) body.append(...knobs.map(k => this.knobRow(k))); };
      box.addEventListener("toggle", fill);
      box.open = open.has(name);
      fill();
      this.groups.append(box);
    }
    const notes = this.hello.notes.map(n => element("p", {class: "hint"}, n));
    turn.replaceChildren(this.search, this.found, this.groups, ...notes);
    this.fillFound();
  }

  // Knobs and numbers of the file whose name has all the words.
  fillFound() {
    const words = this.search.value.toLowerCase().split(/\s+/).filter(w => w);
    const has = text => words.every(w => text.toLowerCase().includes(w));
    this.groups.hidden = words.length > 0;
    if (!words.length) {
      const rows = Object.keys(this.state.now.numbers).map(path => this.numberRow(path)).filter(r => r);
      this.found.replaceChildren(...rows.length ? [element("b", {}, "numbers of the file"), ...rows] : []);
      return;
    }
    const knobs = this.hello.knobs.filter(k => has(`${k.label} ${k.name} ${k.group}`));
    const numbers = this.hello.numbers.filter(n => has(`${n[0]} ${n[3]}`));
    const most = 30, rows = [...knobs.slice(0, most).map(k => this.knobRow(k)),
      ...numbers.slice(0, most).map(n => this.numberRow(n[0]))];
    const more = knobs.length + numbers.length - rows.length;
    this.found.replaceChildren(...rows, element("p", {class: "hint"}, rows.length ?
      more ? `and ${more} more; add a word` : "" : "nothing has these words"));
  }

  knobRow(knob) {
    const [factor, unit] = READER[knob.unit] || [1, knob.unit], now = () => this.state.now.knobs[knob.name] || 0;
    const moved = knob.moves.slice(0, 2).map(([path, value, u]) =>
      value === null ? path : `${path} = ${round(value, 6)} ${u}`).join(", ") +
      (knob.moves.length > 2 ? ` and ${knob.moves.length - 2} more` : "");
    return this.row({key: knob.name, label: knob.label, unit, factor, low: knob.low, high: knob.high,
      middle: 0, sd: knob.sd, now, title: knob.note,
      note: moved + (knob.sd ? `; tolerance ±${round(factor * knob.sd, 3)} ${unit}` : ""),
      set: v => this.change("knob " + knob.name, n => {
        if (v === 0) delete n.knobs[knob.name]; else n.knobs[knob.name] = v;
      })});
  }

  numberRow(path) {
    const found = this.hello.numbers.find(n => n[0] === path);
    if (!found) return null;
    const [, value, unit, source] = found, reach = value ? 0.5 * Math.abs(value) : 1;
    return this.row({key: path, label: path, unit, factor: 1, low: value - reach, high: value + reach, middle: value,
      sd: 0, now: () => this.state.now.numbers[path] ?? value,
      title: source, note: `in the file ${value} ${unit}${source ? ", " + source : ""}`,
      set: v => this.change("number " + path, n => {
        if (v === value) delete n.numbers[path]; else n.numbers[path] = v;
      })});
  }

  // Label, number, slider with its tolerance band, what it moves.
  row({key, label, unit, factor, low, high, middle, sd, now, title, note, set}) {
    const id = `turn-${key}`.replace(/[^\w-]/g, "_");
    const slider = element("input", {type: "range", min: String(low), max: String(high),
      step: String((high - low) / 400), id: `${id}-slider`, "aria-label": `${label} [${unit}]`});
    const value = element("input", {type: "number", class: "value", step: "any", id});
    const reset = button("↺", () => { set(middle); show(); }, {class: "reset", title: "as tabulated",
      "aria-label": `${label} as tabulated`});
    const show = () => {
      const v = now();
      if (document.activeElement !== slider) slider.value = v;
      if (document.activeElement !== value) value.value = String(+(factor * v).toPrecision(6));
      box.classList.toggle("turned", v !== middle);
      reset.disabled = v === middle;
    };
    slider.addEventListener("input", () => { set(Number(slider.value)); show(); });
    value.addEventListener("change", () => {
      if (value.value !== "" && Number.isFinite(Number(value.value))) set(Number(value.value) / factor);
      slider.value = now();
      show();
    });
    const band = element("span", {class: "band"});
    if (sd && high > low) {
      const at = v => 100 * (Math.max(low, Math.min(high, v)) - low) / (high - low);
      band.style.left = at(middle - sd) + "%";
      band.style.width = at(middle + sd) - at(middle - sd) + "%";
    }
    const box = element("div", {class: "knob", title: title || ""},
      element("div", {class: "line"}, element("label", {for: id}, label), value,
        element("span", {class: "unit"}, unit === "1" ? "" : unit), reset),
      element("div", {class: "track"}, band, slider),
      element("div", {class: "note"}, note));
    box.dataset.key = key;
    slider.value = now();
    show();
    return box;
  }

  // -------------------------------------------------------------- play

  fillPlay() {
    if (!this.hello) return;
    const p = this.state.now.playing, bar = this.playBar;
    const kinds = !this.hello.strokes.length ? [["free", "by itself"]] : [...this.hello.strokes.map(s => ["packaged " + s, s.replace(/_/g, " ")]),
      ["press", "pressed, a force"], ["strike", "struck, a speed"], ["slow", "slow press and release"],
      ["repeat", "repetition"], ["drawn", "drawn by hand"]];
    const set = (what, edit) => this.change("play " + what, n => edit(n.playing), true);
    const kind = choice("what is played", kinds, () => {
      const [k, name] = kind.value.split(" ");
      set("kind", q => { q.kind = k; if (name) q.name = name; });
      this.fillPlay();
    });
    kind.value = p.kind === "packaged" ? "packaged " + p.name : p.kind;
    bar.replaceChildren(element("label", {}, "play ", kind));
    const slide = (field, label, low, high, text, logarithmic) => {
      const to = logarithmic ? Math.log : x => x, from = logarithmic ? Math.exp : x => x;
      const input = element("input", {type: "range", min: String(to(low)), max: String(to(high)), step: "any",
        "aria-label": label}), out = element("output", {}, text(p[field]));
      input.value = to(p[field]);
      input.addEventListener("input", () => {
        const v = +from(Number(input.value)).toPrecision(4);
        set(field, q => { q[field] = field === "count" ? Math.round(v) : v; });
        out.textContent = text(v);
      });
      bar.append(element("label", {}, label, input, out));
    };
    const loud = f => f < 1.6 ? "pp" : f < 2.6 ? "p" : f < 4.5 ? "mp" : f < 9 ? "mf" : f < 20 ? "f" : "ff";
    const newton = f => `${round(f, 3)} N, ${loud(f)}`;
    if (p.kind === "press") slide("force", "force", 1.2, 50, newton, true);
    if (p.kind === "strike") slide("speed", "finger speed", 0.05, 1.5, v => `${round(v, 3)} m/s`, true);
    if (p.kind === "slow") slide("speed", "finger speed", 0.01, 0.1, v => `${round(1e3 * v, 3)} mm/s`, true);
    if (p.kind === "free") slide("duration", "lasts", 0.02, 3, v => `${round(v, 3)} s`, true);
    if (p.kind === "repeat") {
      slide("force", "force", 2, 50, newton, true);
      slide("rate", "rate", 2, 15, v => `${round(v, 3)} a second`);
      slide("count", "strikes", 1, 8, v => String(Math.round(v)));
    }
    if (p.kind === "drawn") {
      const what = choice("what is drawn", [["force", "force"], ["motion", "finger motion"]], () => {
        set("drawn", q => { q.drawn = what.value; q.time = []; q.value = []; this.firstDrawing(q); });
        this.fillPlay();
      });
      what.value = p.drawn;
      bar.append(what, this.drawing());
      if (p.time.length < 2) set("drawn", q => this.firstDrawing(q));
    }
    if (navigator.requestMIDIAccess && !this.midi)
      bar.append(button("MIDI", () => this.listen(), {title: "play from a MIDI keyboard: velocity is force"}));
  }

  firstDrawing(q) {
    q.time = [0, 0.02, 0.05, 0.12, 0.2];
    q.value = q.drawn === "force" ? [0, 0, 12, 4, 0] : [0, 0, 0.011, 0.011, 0];
  }

  // A force or motion drawn with mouse or finger, over 0.3 s.
  drawing() {
    const canvas = element("canvas", {class: "draw", role: "img",
      "aria-label": "draw a force or motion over 0.3 s here; by keyboard use the other strokes"});
    const p = this.state.now.playing, top = p.drawn === "force" ? 40 : 0.014, span = 0.3;
    const paint = () => {
      const w = canvas.width = canvas.clientWidth || 440, h = canvas.height = 110, g = canvas.getContext("2d");
      const q = this.state.now.playing;
      g.clearRect(0, 0, w, h);
      g.fillStyle = PAINT.text; g.font = "11px system-ui, sans-serif";
      g.fillText(p.drawn === "force" ? `force to ${top} N, over 300 ms` : `finger to ${1e3 * top} mm, over 300 ms`, 5, 13);
      trace(g, q.time.map((t, i) => [w * t / span, h - 4 - (h - 22) * q.value[i] / top]), false);
      g.strokeStyle = COLOR.a; g.lineWidth = 2; g.stroke();
    };
    let pen = null;
    const at = e => {
      const box = canvas.getBoundingClientRect();
      return [span * Math.max(0, Math.min(1, (e.clientX - box.left) / box.width)),
              top * Math.max(0, Math.min(1, (box.height - 4 - (e.clientY - box.top)) / (box.height - 22)))];
    };
    const put = e => {
      const [t, v] = at(e);
      if (pen.length && t < pen.at(-1)[0] + 0.003) return;
      pen.push([t, v]);
      const points = [[0, 0], ...pen.filter(q => q[0] > 0.001)];
      if (points.at(-1)[1] > 0 && points.at(-1)[0] < span - 0.02) points.push([points.at(-1)[0] + 0.02, 0]);
      this.change("drawing", n => {
        n.playing.time = points.map(q => +q[0].toFixed(4));
        n.playing.value = points.map(q => +q[1].toFixed(5));
      }, true);
      paint();
    };
    canvas.addEventListener("pointerdown", e => { canvas.setPointerCapture(e.pointerId); pen = []; put(e); });
    canvas.addEventListener("pointermove", e => { if (pen) put(e); });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { pen = null; });
    requestAnimationFrame(paint);
    return canvas;
  }

  async listen() {
    try { this.midi = await navigator.requestMIDIAccess(); } catch { this.say("no MIDI", true); return; }
    for (const input of this.midi.inputs.values()) input.onmidimessage = e => {
      const [what, , velocity] = e.data;
      if ((what & 0xf0) !== 0x90 || !velocity) return;
      this.change("midi", n => Object.assign(n.playing,
        {kind: "press", force: +(1.2 * Math.pow(40, velocity / 127)).toPrecision(3)}), true);
      this.fillPlay();
      if (this.viewer) { this.viewer.seek(this.viewer.window[0]); this.viewer.toggle(true); }
    };
    this.say(`MIDI: ${this.midi.inputs.size} inputs`);
  }

  // What answers a message about what is turned and played; null: it failed.
  async tell(way, slot = "a", more = {}) {
    const turned = slot === "b" ? this.state.now.b : this.turned();
    try { return await way({id: 0, turned, playing: this.state.now.playing, ...more}); }
    catch (error) { this.say(error.message, true); return null; }
  }

  // Each sound is played at full scale; how loud a difference is, is said.
  async hearIt(slot, rest = false) {
    const answer = await this.tell(m => this.line.sound(m), slot, rest ? {minus: this.state.now.b} : {});
    if (!answer) return;
    const {level, wav} = answer;
    if (rest) this.say(Number.isFinite(level) ? `A − B is ${round(Math.abs(level), 3)} dB ` +
      `${level < 0 ? "below" : "above"} A` : "A and B sound the same");
    if (this.sound) URL.revokeObjectURL(this.sound.src);
    this.sound = new Audio(URL.createObjectURL(new Blob([wav], {type: "audio/wav"})));
    this.sound.play().catch(e => this.say(String(e), true));
  }

  async save(path = "toml", name = `${this.hello.name}_turned.toml`) {
    const answer = await this.tell(m => this.line.post(path, m));
    if (!answer) return;
    const link = element("a", {href: URL.createObjectURL(await answer.blob()), download: name});
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  // -------------------------------------------------------------- tabs

  fillTab() {
    if (!this.hello) return;
    const names = [["numbers", "Numbers"], ["regulation", "Regulation"], ["touch", "Touch"], ["speeds", "Speeds"],
      ["timing", "Timing"], ["loops", "Contact loops"], ["measured", "Measured"], ["command", "As a command"]];
    this.tabs.replaceChildren(...names.map(([name, text]) => button(text, () => {
      this.tab = name;
      this.fillTab();
      this.wants();
      this.ask(true);
    }, {role: "tab", "aria-selected": String(this.tab === name), "aria-pressed": String(this.tab === name)})));
    this.plots = null;
    const fill = {numbers: this.showNumbers, regulation: () => this.lights(this.last?.targets),
      touch: () => this.touched(this.last?.touch), speeds: () => this.speeded(this.last?.speeds),
      timing: this.showNumbers, loops: () => this.loopTab(), measured: () => this.measuredTab(),
      command: this.showNumbers}[this.tab];
    this.tabBox.replaceChildren();
    if (this.shown.length === 0) this.wants();
    fill.call(this);
  }

  remember(kind, m) { this.last = {...this.last, [kind]: m}; }

  // What follows from the curves that are here already.
  showNumbers() {
    if (!this.got.a) return;
    if (this.tab === "numbers") this.numbersTab();
    if (this.tab === "timing") this.timingTab();
    if (this.tab === "command") this.commandTab();
    if (this.tab === "loops") this.loopPlot();
  }

  // While turning only the texts change.
  numbersTab() {
    const {a, b} = this.got;
    const unit = n => /_time$|duration$/.test(n) ? [1e3, "ms"] : /speed$/.test(n) ? [1, "m/s"] :
      /force$/.test(n) ? [1, "N"] : /gap|travel|swing/.test(n) ? [1e3, "mm"] : [1, ""];
    const names = Object.keys({...a.summary, ...b && b.summary}), energies = Object.entries(a.energy);
    const key = JSON.stringify([names, !!b, a.quality, energies.map(e => e[0]), a.warnings]);
    if (this.numbers?.key !== key || !this.numbers.table.isConnected) {
      const table = element("table", {class: "plain numbers"}), energy = element("table", {class: "plain"}), head = table.insertRow();
      head.append(element("th", {}, a.quality === "full" ? "of the run" : "of the run, while turning"),
        element("th", {class: "n"}, "A"), ...b ? [element("th", {class: "n"}, "B"), element("th", {class: "n"}, "A − B")] : []);
      const rows = (table, names, columns) => names.map(name => {
        const row = table.insertRow(), cells = columns.map(() => element("td", {class: "n"}));
        row.dataset.name = name;
        row.append(element("td", {}, name.replace(/_/g, " ") + (table === energy || !unit(name)[1] ? "" : ` [${unit(name)[1]}]`)), ...cells);
        return cells;
      });
      this.numbers = {key, table, cells: rows(table, names, b ? [1, 2, 3] : [1]), energies: rows(energy, energies.map(e => e[0]), [1])};
      this.tabBox.replaceChildren(element("div", {class: "cards"}, table,
        element("div", {}, ...energies.length ? [element("b", {}, "energy"), energy] : [])),
        ...a.warnings.map(w => element("p", {class: "hint"}, w)));
    }
    names.forEach((name, i) => {
      const [factor] = unit(name), [x, y] = [a.summary[name], b?.summary[name]];
      [x, y, x === undefined || y === undefined ? undefined : x - y].slice(0, b ? 3 : 1).forEach((v, k) => {
        const cell = this.numbers.cells[i][k];
        put(cell, v === undefined ? "–" : round(factor * v, k < 2 ? 5 : 3));
        if (v === undefined) delete cell.dataset.value; else cell.dataset.value = String(v);
      });
    });
    energies.forEach(([name, value], i) => put(this.numbers.energies[i][0],
      /relative/.test(name) ? round(value, 3) : `${round(1e3 * value, 4)} mJ`));
  }

  timingTab() {
    const runs = this.both(), names = [];
    for (const run of runs) for (const [, name] of run.events) if (!names.includes(name)) names.push(name);
    const low = Math.min(...runs.map(r => r.busy[0])), high = Math.max(...runs.map(r => r.busy[1]));
    const grid = element("div", {class: "timing"});
    for (const name of names) {
      const rail = element("div", {class: "rail"}), texts = [];
      runs.forEach((run, i) => {
        const found = run.events.find(e => e[1] === name);
        if (!found) return;
        const dot = element("i");
        dot.style.left = 100 * Math.max(0, Math.min(1, (found[0] - low) / (high - low))) + "%";
        dot.style.background = PAINT.runs[i];
        rail.append(dot);
        texts.push(found[0].toFixed(2));
      });
      grid.append(element("span", {}, name), rail, element("span", {}, texts.join(" / ") + " ms"));
    }
    this.tabBox.replaceChildren(grid);
  }

  commandTab() {
    const set = Object.entries(this.got.a.set), p = this.state.now.playing;
    const quoted = t => /^[\w./=-]+$/.test(t) ? t : `'${t.replace(/'/g, "'\\''")}'`;
    const text = `feltmb stroke ${quoted(this.hello.mechanism)} ${p.kind === "packaged" ? p.name : "stroke.toml"}` +
      set.map(([path, value]) => ` \\\n  --set ${quoted(`${path}=${value}`)}`).join("");
    this.tabBox.replaceChildren(element("p", {class: "hint"}, "The same on the command line" +
      (p.kind === "packaged" ? ":" : ", with the file of Save stroke:")), element("pre", {class: "command"}, text),
      ...p.kind === "packaged" || !this.has("files") ? [] : [button("Save stroke", () => this.save("stroke", "stroke.toml"))]);
  }

  // -------------------------------------------------------------- regulation

  lights(m) {
    if (m) this.remember("targets", m);
    if (this.tab !== "regulation") return;
    const table = element("table", {class: "plain lights"});
    for (const r of m?.rows || []) {
      const row = table.insertRow();
      row.append(element("td", {}, element("i", {class: "light " + (r.holds ? "good" : "bad")}), r.name),
        element("td", {class: "n"}, r.value === null ? "–" : `${round(r.value, 4)} ${r.unit}`),
        element("td", {}, `${r.holds ? "is" : "is not"} ${r.wanted} ${r.unit}` +
          (r.tolerance ? ` ± ${round(r.tolerance, 2)}` : "")), element("td", {class: "hint"}, r.why || r.what));
    }
    const note = m?.fault ? m.fault : !m ? "measuring …" : m.rows.length ? "" : "there are no targets for this mechanism";
    this.tabBox.replaceChildren(table, element("p", {class: "hint"}, note),
      ...!this.has("regulation") ? [] : [button("Regulate", () => { this.say("regulating …");
        this.line.send({do: "regulate", turned: this.turned()}); }, this.hello.targets ? {} : {disabled: ""})],
      element("div", {class: "turnings"}, ...this.turnings || []));
  }

  progressed(m) { this.say(m.text); }

  regulated(m) {
    if (m.fault) { this.say(m.fault, true); return; }
    const turnedBy = m.rows.filter(r => r.turned).map(r => `${r.name} ${r.turned > 0 ? "+" : ""}${round(r.turned, 4)} ${r.unit}`);
    this.turnings = [element("p", {}, turnedBy.length ? "turned: " + turnedBy.join(", ") : "nothing was turned"),
      ...m.rows.filter(r => !r.holds).map(r => element("p", {class: "hint"}, `${r.name}: ${r.why}`))];
    this.say(m.converged ? "regulated" : "regulated, but not all targets hold", !m.converged);
    this.change("regulate", n => { Object.assign(n.knobs, m.knobs); });
    this.fillTurn();
    this.lights(this.last?.targets);
  }

  // -------------------------------------------------------------- curves over another number than time

  // Lines of x and y; uPlot with its own x for each series. Lines that were there before take new data only; true if not.
  plot(where, {x, y, series, top = null}) {
    const width = Math.min(560, find("more").clientWidth - 10), data = [null, ...series.map(s => s.data)];
    const key = JSON.stringify([x, y, top, width, PAINT === NIGHT, series.map(s => [s.name, s.color, s.dash, s.dots])]);
    if (where.plot?.key === key && where.plot.chart.root.isConnected) {
      where.plot.chart.setData(data);
      return false;
    }
    const range = k => u => {
      if (k && top) return [0, top];
      const all = u.data.slice(1).flatMap(d => Array.from(d[k])).filter(Number.isFinite);
      const low = Math.min(...all), high = Math.max(...all), pad = 0.06 * (high - low) || 1;
      return all.length ? [low - pad, high + pad] : [0, 1];
    };
    const lines = (u, i) => {
      uPlot.orient(u, i, (s, dx, dy, sx, sy, toX, toY, left, top, w, h) => {
        const [xs, ys] = u.data[i], path = new Path2D();
        for (let k = 0; k < xs.length; k++) {
          const px = toX(xs[k], sx, w, left), py = toY(ys[k], sy, h, top);
          if (k) path.lineTo(px, py); else path.moveTo(px, py);
        }
        u.ctx.save();
        u.ctx.beginPath();
        u.ctx.rect(left, top, w, h);
        u.ctx.clip();
        u.ctx.strokeStyle = series[i - 1].color;
        u.ctx.lineWidth = 1.8 * devicePixelRatio;
        u.ctx.setLineDash((series[i - 1].dash || []).map(d => d * devicePixelRatio));
        u.ctx.stroke(path);
        if (series[i - 1].dots) for (let k = 0; k < xs.length; k++) {
          u.ctx.beginPath();
          u.ctx.arc(toX(xs[k], sx, w, left), toY(ys[k], sy, h, top), 3.5 * devicePixelRatio, 0, 7);
          u.ctx.fillStyle = series[i - 1].color;
          u.ctx.fill();
        }
        u.ctx.restore();
      });
      return null;
    };
    const axis = label => ({label, stroke: PAINT.text, grid: {stroke: PAINT.grid}, ticks: {stroke: PAINT.grid},
      font: "11px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", labelSize: 22});
    where.replaceChildren();
    // A chart listens to the window until it is destroyed.
    this.charts = (this.charts || []).filter(c => c.root.isConnected || (c.destroy(), false));
    const chart = new uPlot({mode: 2, width, height: 300, legend: {show: false}, cursor: {drag: {x: true, y: true}},
      scales: {x: {time: false, range: range(0)}, y: {range: range(1)}}, axes: [axis(x), axis(y)],
      series: [{}, ...series.map(s => ({label: s.name, stroke: s.color, paths: lines, facets: [
        {scale: "x", auto: true}, {scale: "y", auto: true}]}))]}, data, where);
    this.charts.push(chart);
    where.plot = {key, chart};
    return true;
  }

  legend(series) {
    return element("p", {class: "hint legend"}, ...series.map(s => {
      const swatch = element("i", {class: "stroke"});
      swatch.style.borderTop = `2.5px ${(s.dash || []).length ? "dashed" : "solid"} ${s.color}`;
      return element("span", {}, swatch, s.name);
    }));
  }

  // Keeps what came for a slot; gives A and, where there is one, B.
  pair(kind, m) {
    if (m) this.remember(m.slot === "b" ? kind + " b" : kind, m);
    const b = this.last?.[kind + " b"];
    return [this.last?.[kind], this.state.now.b && b && !b.fault ? b : null];
  }

  touched(m) {
    const [a, b] = this.pair("touch", m);
    m = a;
    if (this.tab !== "touch") return;
    if (!m || m.fault) {
      this.tabBox.replaceChildren(element("p", {class: "hint"}, m ? m.fault : "a slow press and release …"));
      return;
    }
    const series = [];
    for (const [who, found, color] of [["B", b, COLOR.b], ["A", m, COLOR.a]]) if (found)
      for (const [name, x, y] of found.curves) series.push({name: `${who}, ${name}`, data: [x, y], color, dash: name === "release" ? [6, 4] : []});
    const table = element("table", {class: "plain"}), where = element("div");
    m.rows.forEach(([name, value, unit], i) => table.insertRow().append(element("td", {}, name),
      element("td", {class: "n"}, `${round(value, 4)} ${unit}`),
      ...b ? [element("td", {class: "n"}, `B ${round(b.rows[i][1], 4)}`)] : []));
    this.tabBox.replaceChildren(element("div", {class: "cards"}, element("div", {}, where, this.legend(series)), table),
      ...(m.notes || []).map(n => element("p", {class: "hint"}, n)));
    // The force at the bottom of the key would hide those that a hand feels.
    const all = element("input", {type: "checkbox", onchange: () => {
      this.allForces = all.checked;
      this.touched();
    }});
    all.checked = !!this.allForces;
    where.after(element("p", {class: "hint"}, element("label", {}, all, " all forces"), "; drag enlarges, a double click goes back"));
    this.plot(where, {x: "key travel [mm]", y: "force at the key front [N]", series, top: this.allForces ? null : FELT});
  }

  speeded(m) {
    const [a, b] = this.pair("speeds", m);
    m = a;
    if (this.tab !== "speeds") return;
    if (!m || m.fault) {
      this.tabBox.replaceChildren(element("p", {class: "hint"}, m ? m.fault : "strikes from pp to ff …"));
      return;
    }
    const where = element("div");
    const series = [["B", b, COLOR.b], ["A", m, COLOR.a]].filter(s => s[1]).map(([name, found, color]) =>
      ({name: `${name}, pressed from ${found.rows[0]?.[2]} to ${found.rows.at(-1)?.[2]} N`, color, dots: true,
        data: [found.rows.map(r => r[0]), found.rows.map(r => r[1])]}));
    this.tabBox.replaceChildren(where, this.legend(series), element("p", {class: "hint"},
      m.missed ? `${m.missed} strikes do not reach the string` : ""));
    this.plot(where, {x: "largest key speed [m/s]", y: "hammer speed at the string [m/s]", series});
  }

  loopTab() {
    if (this.loop === undefined) this.loop = this.hello.contacts[0]?.[0];
    const select = choice("contact", this.hello.contacts.map(([n, label]) => [String(n), `${n} ${label}`]), () => {
      this.loop = Number(select.value);
      this.wants();
      this.ask(true);
    });
    select.value = String(this.loop);
    this.loopBox = element("div");
    this.tabBox.replaceChildren(element("p", {}, select), this.loopBox);
    if (this.wants()) this.ask(true); else this.loopPlot();
  }

  loopPlot() {
    if (!this.viewer || !this.loopBox) return;
    const n = String(this.loop).padStart(2, "0"), series = [];
    this.viewer.runs.forEach((run, i) => {
      const force = run.curves.get(`contact${n}.force`), depth = run.curves.get(`contact${n}.compression`);
      if (!force || !depth) return;
      const keep = [];
      force.unpack().values.forEach((f, k) => { if (f > 0 || depth.unpack().values[k] > -0.2) keep.push(k); });
      series.unshift({name: run.name, color: PAINT.runs[i], data: [keep.map(k => depth.values[k]), keep.map(k => force.values[k])]});
    });
    if (!series.length || !series.some(s => s.data[0].length > 1)) {
      this.loopBox.replaceChildren(element("p", {class: "hint"}, "this contact does not meet in this stroke"));
      return;
    }
    const met = series.filter(s => s.data[0].length > 1);
    if (this.plot(this.loopBox, {x: "compression [mm]", y: "force [N]", series: met})) this.loopBox.append(this.legend(met));
  }

  // -------------------------------------------------------------- measured

  measuredTab() {
    const pick = element("input", {type: "file", multiple: "", "aria-label": "measured files",
      accept: ".toml,.csv,.txt,.tsv,.dat,.asc,.mat,.nc,.h5,.hdf5,.parquet,.feather,.mcap", onchange: () => this.upload([...pick.files])});
    const kinds = this.has("files") ? "(CSV, MAT, NetCDF; a TOML file describes the file of its name)" : "(CSV)";
    const drop = element("div", {class: "drop"}, `Drop measured files here ${kinds}, or `, pick);
    drop.addEventListener("dragover", e => { e.preventDefault(); drop.classList.add("over"); });
    drop.addEventListener("dragleave", () => drop.classList.remove("over"));
    drop.addEventListener("drop", e => {
      e.preventDefault();
      drop.classList.remove("over");
      this.upload([...e.dataTransfer.files]);
    });
    this.fileBox = element("div");
    this.overlayBox = element("div");
    this.diagnosisBox = element("div");
    this.planBox = element("div");
    this.planStatus = element("span", {class: "hint", role: "status"});
    this.tabBox.replaceChildren(drop, this.fileBox, this.overlayBox, ...!this.has("diagnosis") ? [] : [this.diagnosisBox,
      element("h3", {}, "What to measure next"),
      element("p", {}, button("Propose strokes", () => this.plan()), " ", button("Stop", () => this.line.send({do: "stop"})),
        " ", this.planStatus), this.planBox]);
    this.fillFiles();
    if (this.last?.plan) this.planned(this.last.plan);
    if (this.last?.measured) this.held(this.last.measured);
    if (this.last?.diagnosis) this.diagnosed(this.last.diagnosis);
  }

  async upload(files) {
    for (const file of files) {
      let entry;
      try { entry = await this.line.add(file); } catch (error) { this.say(error.message, true); continue; }
      if (entry.describes) this.say(`${file.name} describes ${entry.describes.join(", ") || "the file of this name that comes"}`);
      else this.hello.files = [...(this.hello.files || []).filter(f => f.file !== entry.file), entry];
    }
    if (this.tab !== "measured") { this.tab = "measured"; this.fillTab(); }
    else this.fillFiles();
    this.measure();
  }

  // Which column is which channel; empty: by its name.
  fillFiles() {
    const files = this.hello.files || [];
    this.reading = this.reading || {columns: {}, units: {}, scales: {}, origins: {}, frame_rate: null, y_up: false};
    if (!files.length) { this.fileBox.replaceChildren(); return; }
    const columns = [...new Set(files.flatMap(f => f.columns.map(c => c[0])))];
    const channels = ["time", "finger.force", "finger.displacement", ...this.hello.outputs.map(o => o[0])
      .filter(n => /\.[xy]$/.test(n))];
    const rows = element("table", {class: "plain"});
    for (const column of columns) {
      const [, unit] = files.flatMap(f => f.columns).find(c => c[0] === column);
      const told = Object.entries(this.reading.columns).find(([, c]) => c === column);
      const select = choice(`channel of ${column}`, [["", "by its name"], ...channels.map(c => [c, c])], () => {
        for (const [c, given] of Object.entries(this.reading.columns)) if (given === column) delete this.reading.columns[c];
        if (select.value) this.reading.columns[select.value] = column;
        this.measure();
      });
      select.value = told ? told[0] : "";
      const units = element("input", {type: "text", size: "6", value: unit, "aria-label": `unit of ${column}`, onchange: () => {
        const channel = select.value || column;
        if (units.value && units.value !== unit) this.reading.units[channel] = units.value; else delete this.reading.units[channel];
        this.measure();
      }});
      rows.insertRow().append(element("td", {}, column), element("td", {}, select), element("td", {}, units));
    }
    this.fileBox.replaceChildren(element("p", {}, ...files.map(f => element("span", {}, f.name + " ",
      button("×", async () => {
        await this.line.remove(f.file);
        this.hello.files = this.hello.files.filter(g => g !== f);
        this.fillFiles();
        this.measure();
      }, {"aria-label": `remove ${f.name}`}), " "))),
      element("details", files.some(f => f.columns.some(c => c[1] === "px")) ? {open: ""} : {}, element("summary", {}, "columns"), rows, ...this.camera()),
      ...!this.has("diagnosis") ? [] : [element("p", {}, button("Diagnose", () => this.diagnose()), " for at most ", this.minutes = element("input",
        {type: "number", class: "minutes", min: "0.5", max: "120", step: "any", value: "5", "aria-label": "minutes of a diagnosis"}),
        " minutes ", button("Stop", () => this.line.send({do: "stop"})),
        " ", this.diagnosing_ = element("span", {class: "hint", role: "status"}))]);
  }

  // How a camera counts: pixels and frames.
  camera() {
    const given = this.reading, put = (table, value) => { if (value) table[""] = value; else delete table[""]; };
    const entry = (label, value, hint, set) => {
      const input = element("input", {type: "text", size: "14", placeholder: hint, "aria-label": label, onchange: () => {
        set(input.value.trim());
        this.measure();
      }});
      input.value = value ?? "";
      return [input, element("label", {}, label + " ", input)];
    };
    const [scale, scaleLabel] = entry("one pixel is", given.scales[""], "0.21 mm", v => put(given.scales, v));
    const [, origin] = entry("origin", given.origins[""], "x,y in pixels, or start", v => put(given.origins, v));
    const [, rate] = entry("frames a second", given.frame_rate, "1000", v => {
      given.frame_rate = Number(v) > 0 ? Number(v) : null;
    });
    const up = element("input", {type: "checkbox", onchange: () => { given.y_up = up.checked; this.measure(); }});
    up.checked = Boolean(given.y_up);
    const set = text => { scale.value = text; put(given.scales, text); this.measure(); };
    return [element("p", {class: "group"}, scaleLabel, origin, rate, element("label", {}, up, " y counts upward")), this.ruler(set)];
  }

  // Two clicks in a picture of the camera, and their distance, give the scale. The picture stays in the browser.
  ruler(set) {
    const canvas = element("canvas", {class: "photo", hidden: "", role: "img", "aria-label": "picture of the camera"});
    const apart = element("input", {type: "text", size: "8", value: "100 mm", "aria-label": "distance of the two points", onchange: () => tell()});
    let image = null, points = [];
    const tell = () => {
      if (points.length === 2) set(`${apart.value} from ${points[0].join(" ")} to ${points[1].join(" ")}`);
    };
    const paint = () => {
      const g = canvas.getContext("2d"), size = image.width / 60;
      g.drawImage(image, 0, 0);
      g.strokeStyle = "#D55E00"; g.lineWidth = size / 5;
      for (const [x, y] of points) { g.beginPath(); g.arc(x, y, size, 0, 7); g.moveTo(x - size, y); g.lineTo(x + size, y); g.stroke(); }
      if (points.length === 2) { trace(g, points); g.stroke(); }
    };
    canvas.addEventListener("click", e => {
      const share = image.width / canvas.clientWidth;
      if (points.length === 2) points = [];
      points.push([e.offsetX, e.offsetY].map(v => +(share * v).toFixed(1)));
      paint();
      tell();
    });
    const pick = element("input", {type: "file", accept: "image/*", "aria-label": "picture of the camera", onchange: async () => {
      try { image = await createImageBitmap(pick.files[0]); } catch { this.say("this is no picture", true); return; }
      [canvas.width, canvas.height, canvas.hidden, points] = [image.width, image.height, false, []];
      paint();
    }});
    return element("div", {}, element("p", {}, "or click two points in a picture of the camera, ", pick, " which are ", apart, " apart"), canvas);
  }

  measure() {
    const files = this.hello?.files || [];
    if (!files.length) { this.overlayBox?.replaceChildren(); return; }
    this.line.send({do: "measure", id: this.id, turned: this.turned(), reading: this.reading || {}, files: files.map(f => f.file)});
  }

  held(m) {
    this.remember("measured", m);
    if (this.tab !== "measured" || !this.overlayBox) return;
    if (m.fault) {
      this.overlayBox.replaceChildren(...m.fault.split("\n").map(t => element("p", {class: "hint"}, t)));
      return;
    }
    const cells = r => [r.record, r.channel, `${round(r.rms, 4)} ${r.unit}`, r.noise ? `${round(r.noise, 3)} times the noise` : ""];
    const key = JSON.stringify([m.rows.map(r => [r.record, r.channel]), PAINT === NIGHT,
      m.records.map(r => [r.name, r.channels.map(c => [c.name, c.unit])])]);
    if (this.overlay?.key !== key || !this.overlay.table.isConnected) {
      const table = element("table", {class: "plain residuals"}), notes = element("div"), wheres = [];
      for (const r of m.rows) table.insertRow().append(...["", "", "n", "hint"].map(name => element("td", {class: name})));
      const boxes = m.records.map(record => element("div", {}, element("b", {}, record.name), this.legend(
        [{name: "measured", color: PAINT.ink}, {name: "model, turned", color: COLOR.a}]),
        ...record.channels.flatMap(channel => [element("div", {}, `${channel.name}, ${channel.unit}`),
          wheres[wheres.push(element("div")) - 1]])));
      this.overlayBox.replaceChildren(table, notes, element("div", {class: "cards"}, ...boxes));
      this.overlay = {key, table, notes, wheres};
    }
    this.overlay.notes.replaceChildren(...m.notes.map(n => element("p", {class: "hint"}, n)));
    m.rows.forEach((r, i) => cells(r).forEach((text, k) => put(this.overlay.table.rows[i].cells[k], text)));
    let at = 0;
    for (const record of m.records) {
      const time = times(record.time);
      for (const channel of record.channels) {
        const [measured, model] = columns(channel.values);
        this.plot(this.overlay.wheres[at++], {x: "time [ms]", y: `${channel.name} [${channel.unit}]`, series: [
          {name: "measured", color: PAINT.ink, data: [time, measured]}, {name: "model, turned", color: COLOR.a, data: [time, model]}]});
      }
    }
  }

  diagnose() {
    this.line.send({do: "diagnose", id: this.id, turned: this.turned(), reading: this.reading || {},
      files: this.hello.files.map(f => f.file), seconds: 60 * Number(this.minutes.value || 5)});
  }

  // Strokes that would tell most of what is not known yet; a click plays one.
  plan() {
    this.line.send({do: "plan", id: this.id, turned: this.turned(), reading: this.reading || {},
      files: (this.hello.files || []).map(f => f.file)});
  }

  planning(m) {
    if (this.planStatus) this.planStatus.textContent = `${m.stage}, ${m.done} of ${m.total} done`;
  }

  planned(m) {
    this.remember("plan", m);
    if (!this.planBox) return;
    this.planStatus.textContent = m.stopped ? "stopped" : "";
    if (m.stopped) return;
    if (m.fault) { this.planBox.replaceChildren(element("p", {class: "hint"}, m.fault)); return; }
    const share = x => `${round(100 * x, 3)} %`;
    const rows = m.rows.map(r => element("li", {}, element("b", {}, r.name), " ",
      button("Play", () => {
        this.change("play planned", n => { n.playing = {...copyOf(FIRST), ...r.playing}; }, true);
        this.fillPlay();
        if (this.viewer) this.viewer.root.scrollIntoView({block: "nearest"});
      }, {"aria-label": `play ${r.name}`}),
      element("ul", {}, ...[`belief in the right name ${share(r.before)} → ${share(r.after)}`, ...r.reasons]
        .map(text => element("li", {}, text)))));
    this.planBox.replaceChildren(element("p", {class: "hint"}, rows.length ? `Planned from: ${m.source}.` :
      "No stroke tells anything more."), element("ol", {class: "proposals"}, ...rows),
      ...m.notes.map(n => element("p", {class: "hint"}, n)));
  }

  diagnosing(m) {
    if (this.diagnosing_) this.diagnosing_.textContent = [m.stage.replace("_", " "), `${round(100 * m.share, 2)} % done`,
      m.left ? `about ${round(m.left, 2)} s left` : ""].filter(t => t).join(", ");
  }

  diagnosed(m) {
    this.remember("diagnosis", m);
    if (this.diagnosing_) this.diagnosing_.textContent = "";
    const clear = () => button("Clear", () => {
      this.answer.hidden = true;
      if (this.viewer?.stage) { this.viewer.stage.tint = null; this.viewer.render(); }
    });
    this.answer.hidden = !m.answer;
    this.answer.replaceChildren(m.answer || "", " ", clear());
    if (!this.diagnosisBox) return;
    if (m.fault) { this.diagnosisBox.replaceChildren(element("p", {class: "hint"}, m.fault)); return; }
    const table = element("table", {class: "plain candidates"});
    const apply = c => !c.knob || !Number.isFinite(c.magnitude) ? "" : button("Apply", () => {
      this.change("apply " + c.knob, n => { n.knobs[c.knob] = (n.knobs[c.knob] || 0) + c.magnitude; });
      this.fillTurn();
    });
    const row = (c, told) => {
      const [factor, unit] = READER[c.unit] || [1, c.unit], number = x => Number.isFinite(x) ? round(factor * x, 3) : "–";
      table.insertRow().append(element("td", {}, told ? element("b", {}, c.effect) : c.effect),
        element("td", {class: "n"}, Number.isFinite(c.magnitude) ? `${number(c.magnitude)} ${unit} (${number(c.low)} to ${number(c.high)})` : "–"),
        element("td", {class: "n"}, c.how), element("td", {}, apply(c)), element("td", {class: "hint"}, c.text));
    };
    for (const c of m.causes) row(c, true);
    for (const c of m.candidates) row(c, false);
    if (this.viewer?.stage) { this.viewer.stage.tint = m.tint; this.viewer.render(); }
    this.diagnosisBox.replaceChildren(element("h3", {}, m.verdict), element("p", {}, m.statement),
      ...m.reasons.map(text => element("p", {class: "hint"}, text)), table,
      element("p", {class: "hint"}, "The parts are colored by the share of the gap that they take away."),
      m.stopped ? element("p", {class: "hint"}, "Stopped: the answer is that of the fits so far.") : "");
  }
}
