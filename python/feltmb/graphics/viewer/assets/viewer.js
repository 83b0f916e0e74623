// The viewer: state, controls, tables. Texts of files become text nodes only, never markup.

// A run of the page, unpacked: its curves each with times of their own, or all with the same.
function unpackRun(r, i) {
  const run = {
    name: r.name, note: r.note || "", events: r.events, first: r.first, last: r.last, busy: r.busy,
    color: PAINT.runs[i % PAINT.runs.length], shown: true, shift: 0,
    stage: r.stage && unpackStage(r.stage),
    curves: new Map(r.outputs.map(o => [o.name, new Curve(o)])),
  };
  if (r.values) {
    const time = times(r.time), values = columns(r.values);
    r.outputs.forEach((o, k) => Object.assign(run.curves.get(o.name), {time, values: values[k]}));
  }
  run.time = now => now + run.shift;  // from the clock of the first run to its own
  return run;
}

class Viewer {
  // `data`: as page.py writes it; default: what the root element holds.
  constructor(root, data = JSON.parse(root.querySelector("script").textContent)) {
    this.root = root;
    this.data = data;
    this.runs = data.runs.map(unpackRun);
    this.known = data.known || null;  // [name, label, unit] of outputs that can be asked for
    this.wanted = () => {};           // called when other outputs are shown
    this.playing = false;
    this.build();
    this.align(data.align);
    this.window = this.wide("busy");
    this.now = Math.max(this.window[0], Math.min(this.window[1], data.at ?? this.window[0]));
    this.layout();
  }

  // Other runs in the place of those that were shown; time, view and panels stay.
  replace(described, {look = false} = {}) {
    const before = this.runs;
    this.runs = described.map(unpackRun);
    this.runs.forEach((run, i) => { if (before[i]) run.shown = before[i].shown; });
    const names = runs => runs.map(r => [r.name, r.note]).flat().join("\n");
    if (names(before) !== names(this.runs)) this.fillHead();
    if (this.stage) this.stage.setRuns(this.runs);
    if (this.strip) this.strip.setRuns(this.runs);
    if (this.forces) this.fillForces();
    this.fillEvents();
    for (const panel of this.panels) {
      panel.runs = this.runs;
      panel.key = null;
      this.fillLegend(panel);
    }
    this.align(this.aligner ? this.aligner.value : "", false);
    if (look) this.look("busy");
    else this.render();
  }

  // ---------------------------------------------------------------- structure

  build() {
    const {root, data, runs} = this;
    this.clock = element("span", {class: "fv-clock"});
    const head = this.head = element("div", {class: "fv-head"});
    this.fillHead();

    const left = this.left = element("div", {class: "fv-left"});
    if (runs.some(r => r.stage)) {
      const canvas = element("canvas", {class: "fv-stage", role: "img",
        "aria-label": "the mechanism at the time of the cursor"});
      const zoom = (text, title, f) => element("button", {type: "button", title, onclick: f}, text);
      left.append(element("div", {class: "fv-frame"}, canvas,
        element("div", {class: "fv-zoom"},
          zoom("+", "nearer (or Ctrl and wheel)", () => this.stage.magnify(1.5)),
          zoom("−", "farther", () => this.stage.magnify(1 / 1.5)),
          zoom("⤢", "all (or double click)", () => { this.stage.reset(); this.render(); }))));
      this.stage = new Stage(canvas, runs);
      this.stage.changed = () => this.render();
      const strip = element("canvas", {class: "fv-string", role: "img",
        "aria-label": "the string from end to end at the time of the cursor"});
      this.strip = new StringStrip(strip, runs);
      if (this.strip.runs.length) left.append(strip); else this.strip = null;
      this.forces = element("table", {class: "fv-table"});
      this.fillForces();
      left.append(this.forces);
    }
    this.right = element("div", {class: "fv-right"});
    this.panels = [];
    this.sight = new IntersectionObserver(found => {
      for (const {target, isIntersecting} of found) {
        const panel = this.panels.find(p => p.box === target);
        if (!panel) continue;
        const late = isIntersecting && panel.inSight === false;
        panel.inSight = isIntersecting;
        if (late) this.drawPanels([panel]);
      }
    });
    this.panelBox = element("div");
    this.events = element("table", {class: "fv-table fv-events"});
    this.fillEvents();
    this.right.append(this.panelBox, this.adder(), this.events);
    const main = element("div", {class: this.stage ? "fv-main" : "fv-main fv-alone"});
    if (this.stage) main.append(left);
    main.append(this.right);
    root.append(head, this.controls(), main, element("p", {class: "fv-hint"},
      (this.stage ? "Arrows: forces on the bodies that move, length by the root of the force. " : "") +
      "Drag in a curve to move the time, with Shift to enlarge a stretch of it. Keys: space plays, arrows step, " +
      "Home and End."));
    for (const given of data.panels) this.addPanel(given);
    for (const name of ["pointerdown", "focusin"])
      root.addEventListener(name, () => { Viewer.used = this; });
    addEventListener("resize", () => this.layout());
  }

  // Names of the runs, each to be shown or not.
  fillHead() {
    this.head.replaceChildren(...this.runs.map(run => {
      const box = element("input", {type: "checkbox", onchange: () => {
        run.shown = box.checked;
        this.render();
      }});
      box.checked = run.shown;
      const swatch = element("i", {class: "fv-swatch"});
      swatch.style.background = run.color;
      return element("label", {class: "fv-chip", title: run.note}, box, swatch, run.name);
    }), this.clock);
    for (const run of this.runs) if (run.note && run.note !== "curves only")
      this.head.append(element("span", {class: "fv-hint"}, `${run.name}: ${run.note}`));
  }

  controls() {
    const {data, runs} = this;
    this.button = element("button", {type: "button", class: "fv-play",
      onclick: () => this.toggle(!this.playing)}, "Play");
    this.slider = element("input", {type: "range", min: "0", max: "10000", step: "1",
      class: "fv-slider", "aria-label": "time", oninput: () => {
        this.toggle(false);
        const [a, b] = this.window;
        this.seek(a + (b - a) * this.slider.value / 10000);
      }});
    this.slow = element("input", {type: "number", min: "0.01", max: "1000000", step: "any",
      class: "fv-number", value: String(data.slowness)});
    const line = element("div", {class: "fv-controls"}, this.button, this.slider,
      element("label", {}, this.slow, " times slower"));
    const spans = [["busy", "all that moves"], ["all", "whole run"], ["20", "20 ms here"],
                   ["5", "5 ms here"], ["1", "1 ms here"]];
    this.span = choice("stretch of time", spans, () => this.look(this.span.value));
    line.append(element("label", {}, "show ", this.span));
    if (this.runs.some(r => r.stage)) {
      this.arrows = element("input", {type: "checkbox", onchange: () => this.render()});
      this.arrows.checked = true;
      this.names = element("input", {type: "checkbox", onchange: () => this.render()});
      line.append(element("label", {}, this.arrows, " forces"), element("label", {}, this.names, " names"));
    }
    if (runs.some(r => r.stage && r.stage.string && r.stage.string.modes)) {
      this.magnified = choice("string displacement", [["1", "as it is"], ["5", "5 times"],
        ["20", "20 times"]], () => this.render());
      line.append(element("label", {}, "string ", this.magnified));
    }
    const common = runs[0].events.map(e => e[1])
      .filter(name => runs.every(r => r.events.some(e => e[1] === name)));
    if (runs.length > 1 && common.length) {
      this.aligner = choice("align runs", [["", "by their clocks"],
        ...common.map(n => [n, "at " + n])], () => { this.align(this.aligner.value); });
      line.append(element("label", {}, "runs ", this.aligner));
    }
    return line;
  }

  fillForces() {
    const rows = new Map(), table = this.forces;
    const key = JSON.stringify(this.runs.map(r => [r.color, r.stage && r.stage.contacts.map(c => [c.number, c.label])]));
    if (this.forcesKey === key) {
      for (const cell of this.forceRows) cell.run = this.runs[cell.r];
      return;
    }
    this.forcesKey = key;
    table.replaceChildren();
    this.runs.forEach((run, r) => {
      if (!run.stage) return;
      run.stage.contacts.forEach((c, k) => {
        if (!rows.has(c.number)) rows.set(c.number, {label: c.label, of: []});
        rows.get(c.number).of.push({run, k, r});
      });
    });
    this.forceRows = [...rows].sort((a, b) => a[0] - b[0]).map(([number, {label, of}]) => {
      const row = table.insertRow();
      const near = element("button", {type: "button", class: "fv-link fv-near", title: "go near this contact",
        onclick: () => this.stage.approach(number, this.now)}, label);
      row.append(element("td", {class: "fv-n"}, String(number)), element("td", {}, near));
      const cells = of.map(({run, k, r}) => {
        const value = element("td", {class: "fv-v"}), bar = element("i", {class: "fv-bar"});
        bar.style.background = run.color;
        row.append(value, element("td", {class: "fv-b"}, bar));
        return {run, k, r, value, bar};
      });
      return cells;
    }).flat();
  }

  fillEvents() {
    const names = [], table = this.events, several = this.runs.length > 1;
    for (const run of this.runs) for (const [, name] of run.events)
      if (!names.includes(name)) names.push(name);
    const key = JSON.stringify([names, this.runs.map(r => r.color)]);
    if (this.eventsKey !== key) {
      this.eventsKey = key;
      table.replaceChildren();
      this.eventCells = names.map(name => {
        const row = table.insertRow();
        const go = element("button", {type: "button", class: "fv-link", onclick: () => {
          const run = this.runs.find(r => r.events.some(e => e[1] === name));
          this.toggle(false);
          this.seek(run.events.find(e => e[1] === name)[0] - run.shift, true);
        }}, name);
        const cells = this.runs.map(run => {
          const cell = element("td", {class: "fv-v"});
          cell.style.color = several ? run.color : "";
          return cell;
        });
        row.append(element("td", {}, go), ...cells);
        return cells;
      });
    }
    names.forEach((name, i) => this.runs.forEach((run, r) => {
      const found = run.events.find(e => e[1] === name);
      put(this.eventCells[i][r], found ? found[0].toFixed(2) + " ms" : "–");
    }));
  }

  adder() {
    const all = this.outputs((name, unit) => `${name}, ${unit}`);
    const select = choice("add a curve", [["", "add a curve …"], ...all], () => {
      if (select.value)
        this.addPanel({title: "", outputs: [select.value], change: false});
      select.value = "";
      this.wanted();
      this.layout();
    });
    return element("div", {class: "fv-adder"}, select);
  }

  // Text by name of the outputs that can be shown.
  outputs(text, only = null) {
    const all = new Map(), put = (name, unit) => {
      if (!all.has(name) && (only === null || unit === only)) all.set(name, text(name, unit));
    };
    for (const [name, , unit] of this.known || []) put(name, unit);
    for (const run of this.runs) for (const [name, curve] of run.curves) put(name, curve.output.unit);
    return all;
  }

  addPanel(given) {
    const panel = new Panel(given, this.runs);
    const known = (this.known || []).find(o => o[0] === given.outputs[0]);
    const unit = panel.unit() || (known ? known[2] : "");
    const same = this.outputs(name => name, unit);
    panel.legend = element("span", {class: "fv-legend"});
    const more = choice("add a curve to this panel", [["", "+"], ...same], () => {
      if (more.value && !panel.outputs.includes(more.value)) panel.outputs.push(more.value);
      more.value = "";
      this.fillLegend(panel);
      this.render();
      this.wanted();
    });
    more.className = "fv-more";
    const change = element("input", {type: "checkbox", onchange: () => {
      panel.change = change.checked;
      this.render();
    }});
    change.checked = panel.change;
    const close = element("button", {type: "button", title: "remove", class: "fv-close",
      onclick: () => {
        this.panels = this.panels.filter(p => p !== panel);
        panel.box.remove();
        this.sight.unobserve(panel.box);
        this.wanted();
      }}, "×");
    panel.box = element("div", {class: "fv-panel"},
      element("div", {class: "fv-panel-head"},
        element("b", {}, (panel.title ? panel.title + ", " : "") + unit), panel.legend,
        element("span", {class: "fv-tools"}, more,
          element("label", {class: "fv-hint", title: "change since the start"}, change, "change"),
          close)),
      panel.canvas);
    this.fillLegend(panel);
    this.panelBox.append(panel.box);
    this.panels.push(panel);
    this.sight.observe(panel.box);
    this.scrub(panel);
    return panel;
  }

  fillLegend(panel) {
    const key = JSON.stringify([PAINT === NIGHT, panel.outputs, this.runs.map(r => [r.color,
      panel.outputs.map(n => r.curves.get(n)?.output.label)])]);
    if (panel.legendKey === key) {
      for (const reading of panel.readings) reading.run = this.runs[reading.r];
      return;
    }
    panel.legendKey = key;
    panel.legend.replaceChildren();
    panel.readings = [];
    panel.box.classList.toggle("fv-many", panel.outputs.length > 1);
    panel.outputs.forEach((name, o) => {
      const item = element("span", {class: "fv-item"});
      if (panel.outputs.length > 1) {
        const swatch = element("i", {class: "fv-swatch"});
        swatch.style.background = panel.color(o, 0);
        item.append(swatch);
      }
      const curve = this.runs.map(r => r.curves.get(name)).find(c => c);
      item.append(curve ? curve.output.label : name);
      item.title = curve ? `${name}: ${curve.output.text}` : name;
      this.runs.forEach((run, r) => {
        if (!run.curves.has(name)) return;
        const value = element("span", {class: "fv-v"});
        if (this.runs.length > 1) value.style.color = run.color;
        item.append(" ", value);
        panel.readings.push({run, r, name, value});
      });
      panel.legend.append(item);
    });
  }

  // A drag moves the time; with Shift it enlarges a stretch; a double click shows all.
  scrub(panel) {
    const canvas = panel.canvas;
    let from = null, stretch = false;
    const at = e => panel.timeAt(e.clientX - canvas.getBoundingClientRect().left, this.window);
    canvas.addEventListener("pointerdown", e => {
      canvas.setPointerCapture(e.pointerId);
      this.root.focus({preventScroll: true});
      from = at(e);
      stretch = e.shiftKey;
      if (e.pointerType === "touch") return;  // a finger may want to scroll the page
      this.toggle(false);
      if (!stretch) this.seek(from);
    });
    canvas.addEventListener("pointermove", e => {
      if (from === null || stretch) return;
      this.toggle(false);
      this.seek(at(e));
    });
    canvas.addEventListener("pointerup", e => {
      if (from === null) return;
      const to = at(e);
      if (!stretch) {
        this.toggle(false);
        this.seek(to);
      } else if (Math.abs(to - from) > 1e-3 * (this.window[1] - this.window[0]))
        this.zoomTo(Math.min(from, to), Math.max(from, to));
      from = null;
    });
    canvas.addEventListener("pointercancel", () => { from = null; });
    canvas.addEventListener("dblclick", () => { this.span.value = "busy"; this.look("busy"); });
  }

  // ---------------------------------------------------------------- time

  // What is shown at most: the whole of all runs, or all that moves, on the first run's clock.
  wide(which) {
    const ends = this.runs.map(r => which === "all" ? [r.first, r.last] : r.busy);
    return [Math.min(...ends.map((e, i) => e[0] - this.runs[i].shift)),
            Math.max(...ends.map((e, i) => e[1] - this.runs[i].shift))];
  }

  look(which) {
    if (which === "busy" || which === "all") return this.zoomTo(...this.wide(which));
    const half = 0.5 * Number(which);
    this.zoomTo(this.now - half, this.now + half);
  }

  zoomTo(a, b) {
    this.window = [a, Math.max(b, a + 1e-6)];
    this.now = Math.max(a, Math.min(b, this.now));
    this.render();
  }

  align(event, show = true) {
    const of = run => (run.events.find(e => e[1] === event) || [NaN])[0];
    const here = of(this.runs[0]);
    for (const run of this.runs) {
      const there = of(run);
      run.shift = event && Number.isFinite(here + there) ? there - here : 0;
    }
    if (this.aligner) this.aligner.value = event || "";
    if (this.window && show) this.look("busy");
  }

  seek(t, reveal = false) {
    const [a, b] = this.window;
    if (reveal && (t < a || t > b)) {
      const [low, high] = this.wide("all");
      this.window = [Math.min(low, t), Math.max(high, t)];
      this.span.value = "all";
    }
    this.now = Math.max(this.window[0], Math.min(this.window[1], t));
    this.render();
  }

  toggle(on) {
    if (this.playing === on) return;
    this.playing = on;
    this.stamp = null;
    this.button.textContent = on ? "Pause" : "Play";
    if (on) requestAnimationFrame(t => this.tick(t));
  }

  tick(stamp) {
    if (!this.playing) return;
    const slowness = Number(this.slow.value) > 0 ? Number(this.slow.value) : this.data.slowness;
    if (this.stamp !== null) this.now += Math.max(0, stamp - this.stamp) / slowness;
    this.stamp = stamp;
    if (!(this.now < this.window[1])) this.now = this.window[0];
    this.render();
    requestAnimationFrame(t => this.tick(t));
  }

  key(e) {
    if (e.ctrlKey || e.altKey || e.metaKey || e.defaultPrevented) return;  // of the browser
    if (/^(INPUT|SELECT|TEXTAREA)$/.test(e.target.tagName) && e.target.type !== "range" &&
        e.target.type !== "checkbox") return;
    const step = (this.window[1] - this.window[0]) / (e.shiftKey ? 50 : 500);
    const to = {ArrowRight: this.now + step, ArrowLeft: this.now - step,
                Home: this.window[0], End: this.window[1]}[e.key];
    if (e.key === " " && e.target.tagName !== "BUTTON") this.toggle(!this.playing);
    else if (to !== undefined) { this.toggle(false); this.seek(to); } else return;
    e.preventDefault();
  }

  // Place [mm] and angle [rad] of a body of a run at the cursor, for scripts around the viewer.
  pose(run, body) {
    const s = this.runs[run].stage;
    return poseOf(s, body, locate(s.time, this.runs[run].time(this.now)));
  }

  // ---------------------------------------------------------------- drawing

  layout() {
    const dpr = devicePixelRatio || 1;
    if (this.stage) this.stage.fit(dpr);
    if (this.strip) this.strip.fit(dpr);
    for (const panel of this.panels) panel.fit(dpr, 128);
    this.render();
  }

  marks() {
    const out = [];
    for (const run of this.runs) if (run.shown)
      for (const [t] of run.events) out.push([t - run.shift, run.color]);
    return out;
  }

  drawPanels(panels) {
    const marks = this.marks();
    for (const panel of panels) {
      if (!panel.width) panel.fit(devicePixelRatio || 1, 128);
      panel.draw(this.now, this.window, marks);
      for (const {run, name, value} of panel.readings)
        put(value, valueText(panel.value(run, name, this.now), panel.limits[1] - panel.limits[0]));
    }
  }

  render() {
    const {now, window} = this;
    if (now === undefined) return;
    if (this.stage) this.stage.draw(now, {arrows: this.arrows.checked, names: this.names.checked,
      magnified: this.magnified ? Number(this.magnified.value) : 1});
    if (this.strip) this.strip.draw(now);
    // Panels out of sight wait until nothing is drawn any more.
    clearTimeout(this.resting);
    const [seen, unseen] = [true, false].map(sight => this.panels.filter(p => (p.inSight ?? true) === sight));
    this.drawPanels(seen);
    if (unseen.length) this.resting = setTimeout(() => this.drawPanels(unseen), 200);
    const digits = Math.max(1, Math.min(6, 3 - Math.floor(Math.log10(window[1] - window[0]))));
    put(this.clock, now.toFixed(digits) + " ms");
    this.slider.value = Math.round(10000 * (now - window[0]) / (window[1] - window[0]));
    const largest = Math.max(...this.runs.map(r => r.stage ? r.stage.largest : 0), 1e-30);
    for (const {run, k, value, bar} of this.forceRows || []) {
      const s = run.stage, force = mix(s.forces[k], locate(s.time, run.time(now)));
      put(value, run.shown && force > 0 ? force.toFixed(2) + " N" : "");
      bar.style.width = (run.shown && force > 0 ? 60 * Math.sqrt(force / largest) : 0) + "px";
    }
  }
}

// Keys work without a click: they go to the viewer that was used last, or to the only one if it is
// in sight. What has the focus elsewhere on the page keeps its keys.
addEventListener("keydown", e => {
  const all = [...document.querySelectorAll(".feltmb-view")].map(r => r.viewer).filter(v => v);
  const inside = e.target.closest && e.target.closest(".feltmb-view");
  const free = e.target === document.body || e.target === document.documentElement;
  const seen = v => {
    const {top, bottom} = v.root.getBoundingClientRect();
    return bottom > 0 && top < innerHeight;
  };
  const viewer = inside ? inside.viewer : !free ? null :
    all.includes(Viewer.used) ? Viewer.used : all.length === 1 ? all[0] : null;
  if (viewer && (inside || seen(viewer))) viewer.key(e);
});

function start() {
  for (const root of document.querySelectorAll(".feltmb-view")) {
    if (root.viewer) continue;
    root.viewer = new Viewer(root);
  }
}

if (document.readyState === "loading") addEventListener("DOMContentLoaded", start);
else start();
