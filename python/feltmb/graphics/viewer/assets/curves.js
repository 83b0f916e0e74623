// One panel of curves over time with a cursor. Times in ms on the clock of the first run.

const DASHES = [[], [6, 4], [2, 3], [8, 3, 2, 3], [1, 2], [10, 5]];
const LEFT = 52, RIGHT = 10, TOP = 6, BOTTOM = 18;

function niceStep(span, count) {
  const raw = span / count, power = Math.pow(10, Math.floor(Math.log10(raw)));
  return power * [1, 2, 5, 10].find(m => m * power >= raw);
}

// A number of the size of `step`, without more digits than it needs.
function tickText(value, step) {
  const digits = Math.max(0, Math.min(12, -Math.floor(Math.log10(step) + 1e-9)));
  const size = Math.abs(value);
  if (size >= 1e6 || (step < 1e-5 && size > 0)) return value.toExponential(1);
  return value.toFixed(digits);
}

// A value among values that span `span`: the digits that the packed numbers carry.
function valueText(value, span) {
  if (!Number.isFinite(value)) return "–";
  if (!(span > 0)) return String(+value.toPrecision(4));
  if (span < 1e-3 || span >= 1e6) return value.toExponential(2);
  const text = value.toFixed(Math.max(0, Math.min(6, 3 - Math.ceil(Math.log10(span)))));
  return /^-0\.?0*$/.test(text) ? text.slice(1) : text;
}

// A curve as packed in the page; unpacked when first looked at.
class Curve {
  constructor(output) { this.output = output; }

  unpack() {
    if (!this.time) {
      this.time = times(this.output.time);
      this.values = columns(this.output.value)[0];
    }
    return this;
  }

  at(t) {
    this.unpack();
    const n = this.time.length, slack = 1e-9 * (this.time[n - 1] - this.time[0]);
    if (t < this.time[0] - slack || t > this.time[n - 1] + slack) return NaN;
    const f = locate(this.time, t);
    // At a sample its own value, whatever its neighbor is: that one may be missing.
    if (f[2] === 0) return this.values[f[0]];
    if (f[2] === 1) return this.values[f[1]];
    return mix(this.values, f);
  }
}

class Panel {
  // `outputs`: names; `runs`: [{curves: Map, color, shown, time}]
  constructor(given, runs) {
    this.title = given.title;
    this.outputs = given.outputs.slice();
    this.change = given.change;
    this.runs = runs;
    this.canvas = document.createElement("canvas");
  }

  unit() {
    for (const run of this.runs) {
      const curve = run.curves.get(this.outputs[0]);
      if (curve) return curve.output.unit;
    }
    return "";
  }

  // One output: the runs differ in color. Several: outputs in color, runs in dash.
  color(output, run) {
    return this.outputs.length === 1 ? this.runs[run].color
      : PAINT.curves[output % PAINT.curves.length];
  }

  value(run, name, now) {
    const curve = run.curves.get(name);
    if (!curve || curve.output.unit !== this.unit()) return NaN;
    return curve.at(run.time(now)) - this.start(curve);
  }

  start(curve) {
    if (!this.change) return 0;
    return curve.unpack().values.find(Number.isFinite) ?? 0;
  }

  fit(dpr, height) {
    this.dpr = dpr;
    this.width = Math.max(120, this.canvas.parentElement.clientWidth);
    this.height = height;
    this.canvas.width = Math.round(this.width * dpr);
    this.canvas.height = Math.round(height * dpr);
    this.canvas.style.height = height + "px";
    this.key = null;
  }

  timeAt(x, [a, b]) {
    return a + (b - a) * Math.max(0, Math.min(1, (x - LEFT) / (this.width - LEFT - RIGHT)));
  }

  // [first, last] samples to draw of a curve, one beyond each edge of the window.
  visible(curve, from, to) {
    const time = curve.unpack().time;
    return [locate(time, from)[0], Math.min(time.length - 1, locate(time, to)[1])];
  }

  range(window) {
    let low = Infinity, high = -Infinity;
    const seen = v => { if (v < low) low = v; if (v > high) high = v; };
    for (const run of this.runs) {
      if (!run.shown) continue;
      const from = run.time(window[0]), to = run.time(window[1]);
      for (const name of this.outputs) {
        const curve = run.curves.get(name);
        if (!curve || curve.output.unit !== this.unit()) continue;
        const zero = this.start(curve), [i, k] = this.visible(curve, from, to);
        for (let j = i; j <= k; j++)
          if (curve.time[j] >= from && curve.time[j] <= to) seen(curve.values[j] - zero);
        seen(curve.at(from) - zero);
        seen(curve.at(to) - zero);
      }
    }
    if (!(high >= low)) return [0, 1];
    const pad = 0.07 * (high - low) || Math.abs(0.1 * high) || 1;
    return [low - pad, high + pad];
  }

  // What does not change with the cursor.
  drawStill(g, window, events) {
    const w = this.width, h = this.height;
    g.setTransform(this.dpr, 0, 0, this.dpr, 0, 0);
    const [low, high] = this.limits = this.range(window), [a, b] = window;
    const X = t => LEFT + (w - LEFT - RIGHT) * (t - a) / (b - a);
    const Y = v => h - BOTTOM - (h - BOTTOM - TOP) * (v - low) / (high - low);
    this.X = X;
    this.Y = Y;
    g.font = "11px system-ui, sans-serif";
    g.strokeStyle = PAINT.grid; g.fillStyle = PAINT.text; g.lineWidth = 1;
    g.textAlign = "right"; g.textBaseline = "middle";
    const sv = niceStep(high - low, Math.max(2, h / 32)), st = niceStep(b - a, w / 70);
    for (let v = Math.ceil(low / sv) * sv; v <= high; v += sv) {
      g.beginPath(); g.moveTo(LEFT, Y(v)); g.lineTo(w - RIGHT, Y(v)); g.stroke();
      g.fillText(tickText(Math.abs(v) < 1e-9 * sv ? 0 : v, sv), LEFT - 5, Y(v));
    }
    g.textAlign = "center"; g.textBaseline = "top";
    for (let t = Math.ceil(a / st) * st; t <= b + 1e-9 * st; t += st) {
      g.beginPath(); g.moveTo(X(t), TOP); g.lineTo(X(t), h - BOTTOM); g.stroke();
      g.fillText(tickText(t, st), X(t), h - BOTTOM + 4);
    }
    g.save();
    g.beginPath();
    g.rect(LEFT, TOP, w - LEFT - RIGHT, h - TOP - BOTTOM);
    g.clip();
    g.setLineDash([3, 3]);
    for (const [t, color] of events) {
      g.strokeStyle = color; g.globalAlpha = 0.45;
      g.beginPath(); g.moveTo(X(t), TOP); g.lineTo(X(t), h - BOTTOM); g.stroke();
    }
    g.globalAlpha = 1;
    this.runs.forEach((run, r) => {
      if (!run.shown) return;
      this.outputs.forEach((name, o) => {
        const curve = run.curves.get(name);
        if (!curve || curve.output.unit !== this.unit()) return;
        const zero = this.start(curve), shift = run.time(0);
        const [i, k] = this.visible(curve, run.time(a), run.time(b));
        g.strokeStyle = this.color(o, r);
        g.setLineDash(this.outputs.length > 1 ? DASHES[r % DASHES.length] : []);
        g.lineWidth = r ? 1.3 : 1.6;
        g.beginPath();
        let down = false;
        for (let j = i; j <= k; j++) {
          const v = curve.values[j];
          if (!Number.isFinite(v)) { down = false; continue; }
          const x = X(curve.time[j] - shift), y = Y(v - zero);
          if (down) g.lineTo(x, y); else g.moveTo(x, y);
          down = true;
        }
        g.stroke();
      });
    });
    g.restore();
  }

  keep(window, events) {
    this.still ||= document.createElement("canvas");
    this.still.width = this.canvas.width;
    this.still.height = this.canvas.height;
    this.drawStill(this.still.getContext("2d"), window, events);
    this.kept = true;
  }

  draw(now, window, events) {
    const key = JSON.stringify([window, this.outputs, this.change, events,
                                this.runs.map(r => [r.shown, r.time(0)])]);
    const g = this.canvas.getContext("2d");
    g.setTransform(1, 0, 0, 1, 0, 0);
    g.clearRect(0, 0, this.canvas.width, this.canvas.height);
    if (this.key !== key) {
      this.key = key;
      this.kept = false;
      this.drawStill(g, window, events);
    } else {
      // Drawn a second time, only the cursor has moved: from now on the rest is copied.
      if (!this.kept) this.keep(window, events);
      g.drawImage(this.still, 0, 0);
    }
    if (now < window[0] || now > window[1]) return;
    g.setTransform(this.dpr, 0, 0, this.dpr, 0, 0);
    const x = this.X(now);
    g.strokeStyle = PAINT.cursor; g.lineWidth = 1;
    g.beginPath(); g.moveTo(x, TOP); g.lineTo(x, this.height - BOTTOM); g.stroke();
    this.runs.forEach((run, r) => {
      if (!run.shown) return;
      this.outputs.forEach((name, o) => {
        const v = this.value(run, name, now);
        if (!Number.isFinite(v)) return;
        g.beginPath(); g.arc(x, this.Y(v), 3.2, 0, 7);
        g.fillStyle = this.color(o, r); g.fill();
      });
    });
  }
}
