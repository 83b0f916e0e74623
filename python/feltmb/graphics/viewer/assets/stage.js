// The mechanism at a time: bodies, contact surfaces, straps, string, forces. Lengths in mm.

// What a run needs to be drawn: a look, which many runs may share, and a motion, both as packed numbers. Surfaces
// are where they are in the look, but for the difference of the shifts of both.
function unpackStage(motion) {
  const {look, modes} = motion, {string} = look, here = motion.shifts || {}, there = look.shifts || {};
  look.points ||= lines(look.outlines);
  if (string?.shapes) look.modes ||= columns(string.shapes);
  const shifted = ({surface}, points) => {
    const [a, b] = [here[surface] || [0, 0], there[surface] || [0, 0]], x = a[0] - b[0], y = a[1] - b[1];
    return x || y ? points.map(p => [p[0] + x, p[1] + y]) : points;
  };
  return {
    ...look,
    shapes: look.shapes.map((shape, i) => ({...shape, points: shifted(shape, look.points[i])})),
    time: times(motion.time),
    poses: columns(motion.poses),
    contacts: motion.numbers.map(n => look.contacts.find(c => c.number === n)),
    places: columns(motion.places),
    forces: columns(motion.forces),
    largest: motion.largest,
    beams: look.beams.map((b, i) => ({...b, line: columns(motion.lines[i])})),
    finger: look.finger && motion.finger && {...look.finger, force: columns(motion.finger)[0]},
    string: string && {...string, modes: modes && {...modes, time: times(modes.time), eta: columns(modes.eta),
      shapes: modes.which.map(k => look.modes[k])}},
  };
}

function poseOf(s, body, f) {
  const p = s.poses;
  return [mix(p[3 * body], f), mix(p[3 * body + 1], f), mix(p[3 * body + 2], f)];
}

function placeOf(s, body, x, y, f) {
  const [px, py, angle] = poseOf(s, body, f), c = Math.cos(angle), d = Math.sin(angle);
  return [px + c * x - d * y, py + d * x + c * y];
}

function trace(g, points, close) {
  g.beginPath();
  points.forEach((p, i) => i ? g.lineTo(p[0], p[1]) : g.moveTo(p[0], p[1]));
  if (close) g.closePath();
}

// Height of a line of text, and shifts of a label from its place, short ones first (CSS pixels).
const TEXT = 13;
const SHIFTS = [[0, 0], ...[1, 1.6, 2.4, 3.4, 4.8].flatMap(r => [[0, -1], [0, 1], [1, 0], [-1, 0],
  [0.9, -0.8], [-0.9, -0.8], [0.9, 0.8], [-0.9, 0.8]].map(([x, y]) => [1.6 * TEXT * r * x, TEXT * r * y]))];

// Points of a shape of a flexible beam. A contact surface stays straight: it moves with the cross
// section that it is fixed to.
function bendShape(beam, shape, f) {
  const n = beam.line.length / 2 - 1;
  const node = i => [mix(beam.line[2 * i], f), mix(beam.line[2 * i + 1], f)];
  return shape.points.map(([x, y]) => {
    const at = shape.station ?? Math.max(0, Math.min(beam.length, x)), w = at / beam.length * n;
    const i = Math.max(0, Math.min(n - 1, Math.floor(w))), p = node(i), q = node(i + 1);
    const l = Math.hypot(q[0] - p[0], q[1] - p[1]);
    const tx = (q[0] - p[0]) / l, ty = (q[1] - p[1]) / l;
    return [p[0] + (q[0] - p[0]) * (w - i) + (x - at) * tx - y * ty,
            p[1] + (q[1] - p[1]) * (w - i) + (x - at) * ty + y * tx];
  });
}

// Displacement of the string [mm] away from the hammer at the points of the modes' shapes.
function stringShape(string, t) {
  const modes = string.modes;
  if (!modes) return null;
  const f = locate(modes.time, t), out = new Float64Array(modes.shapes[0].length);
  modes.shapes.forEach((shape, j) => {
    const eta = mix(modes.eta[j], f);
    for (let i = 0; i < out.length; i++) out[i] += eta * shape[i];
  });
  return out;
}

class Stage {
  // `runs`: [{stage, color, shown, time: t => time on the clock of that run}]
  constructor(canvas, runs) {
    this.canvas = canvas;
    this.scratch = document.createElement("canvas");
    this.setRuns(runs);
    this.reset();
    let last = null;
    canvas.addEventListener("pointerdown", e => {
      last = [e.clientX, e.clientY];
      canvas.setPointerCapture(e.pointerId);
    });
    canvas.addEventListener("pointermove", e => {
      if (!last) return;
      this.center[0] -= (e.clientX - last[0]) / this.pixels;
      this.center[1] += (e.clientY - last[1]) / this.pixels;
      last = [e.clientX, e.clientY];
      this.changed();
    });
    for (const name of ["pointerup", "pointercancel"])
      canvas.addEventListener(name, () => { last = null; });
    canvas.addEventListener("dblclick", () => { this.reset(); this.changed(); });
    canvas.addEventListener("wheel", e => {
      if (!e.ctrlKey && !e.shiftKey) return;  // else the page scrolls
      e.preventDefault();
      this.magnify(Math.exp(-0.002 * (e.deltaY || e.deltaX)), e.offsetX, e.offsetY);
    }, {passive: false});
    this.changed = () => {};
  }

  // The view only grows, so that the picture stands still while something is turned.
  setRuns(runs) {
    this.runs = runs.filter(r => r.stage);
    const boxes = this.runs.map(r => r.stage.view);
    if (this.low) boxes.push([this.low, this.high]);
    this.low = [0, 1].map(k => Math.min(...boxes.map(b => b[0][k])));
    this.high = [0, 1].map(k => Math.max(...boxes.map(b => b[1][k])));
  }

  reset() {
    this.zoom = 1;
    this.canvas.style.touchAction = "";
    this.center = [0, 1].map(k => 0.5 * (this.low[k] + this.high[k]));
  }

  magnify(factor, x = 0.5 * this.canvas.clientWidth, y = 0.5 * this.canvas.clientHeight) {
    const zoom = Math.max(0.5, Math.min(200, this.zoom * factor)), share = 1 - this.zoom / zoom;
    this.center[0] += share * (x - 0.5 * this.canvas.clientWidth) / this.pixels;
    this.center[1] -= share * (y - 0.5 * this.canvas.clientHeight) / this.pixels;
    this.zoom = zoom;
    // Enlarged, a finger moves the picture in all directions; else the page scrolls.
    this.canvas.style.touchAction = zoom > 1 ? "none" : "";
    this.changed();
  }

  // Go near a contact as it is at a time of the first run that has it.
  approach(number, now) {
    for (const run of this.runs) {
      const s = run.stage, k = s.contacts.findIndex(c => c.number === number);
      if (k < 0) continue;
      const f = locate(s.time, run.time(now));
      this.reset();
      this.center = [mix(s.places[4 * k], f), mix(s.places[4 * k + 1], f)];
      this.magnify(9);
      return;
    }
  }

  fit(dpr) {
    const ratio = (this.high[1] - this.low[1]) / (this.high[0] - this.low[0]);
    const width = this.canvas.parentElement.clientWidth;
    const height = Math.max(200, Math.min(width * ratio, 0.78 * innerHeight));
    this.canvas.style.height = height + "px";
    for (const c of [this.canvas, this.scratch]) {
      c.width = Math.max(1, Math.round(width * dpr));
      c.height = Math.max(1, Math.round(height * dpr));
    }
    this.dpr = dpr;
  }

  draw(now, options) {
    const g = this.canvas.getContext("2d"), {width, height} = this.canvas;
    const fitting = Math.min(width / (this.high[0] - this.low[0]),
                             height / (this.high[1] - this.low[1]));
    const scale = fitting * this.zoom;
    this.pixels = scale / this.dpr;
    const place = [scale, 0, 0, -scale,
                   0.5 * width - scale * this.center[0], 0.5 * height + scale * this.center[1]];
    g.setTransform(1, 0, 0, 1, 0, 0);
    g.clearRect(0, 0, width, height);
    const px = this.dpr / scale;  // one CSS pixel in mm
    const shown = this.runs.filter(r => r.shown);
    shown.forEach((run, order) => {
      const t = run.time(now), f = locate(run.stage.time, t);
      const layer = {g, f, t, px, place, s: run.stage, color: run.color};
      for (const c of [g, this.scratch.getContext("2d")]) {
        c.setTransform(...place);
        c.lineJoin = c.lineCap = "round";
      }
      this.drawString(layer, order, options.magnified);
      if (order === 0) this.drawGround(layer);
      run.stage.bodies.forEach((body, b) =>
        order === 0 ? this.drawBody(layer, b) : this.drawOutline(layer, b));
      this.drawLinks(layer, order);
    });
    const largest = Math.max(...shown.map(r => r.stage.largest), 0);
    for (const run of options.arrows ? shown : []) {
      const t = run.time(now), f = locate(run.stage.time, t);
      this.drawForces({g, f, px, s: run.stage, color: run.color}, largest);
    }
    if (options.names && shown.length) this.drawNames(shown[0].stage, shown[0].time(now), place);
  }

  // Numbers of the contacts as in the table, and names of the parts: each at the nearest free place.
  drawNames(s, t, place) {
    const g = this.canvas.getContext("2d"), f = locate(s.time, t), d = this.dpr, taken = [];
    g.setTransform(d, 0, 0, d, 0, 0);
    g.textAlign = "center"; g.textBaseline = "middle"; g.strokeStyle = PAINT.paper;
    const write = (text, [x, y], font, color) => {
      const at = [(place[0] * x + place[4]) / d, (place[3] * y + place[5]) / d];
      g.font = font; g.fillStyle = color;
      const w = 0.5 * g.measureText(text).width + 2;
      const free = ([dx, dy]) => taken.every(o => Math.abs(at[0] + dx - o[0]) > w + o[2] ||
        Math.abs(at[1] + dy - o[1]) > TEXT);
      const [dx, dy] = SHIFTS.find(free) || SHIFTS[0], put = [at[0] + dx, at[1] + dy];
      taken.push([...put, w]);
      if (Math.hypot(dx, dy) > TEXT) {
        trace(g, [at, put], false);
        g.lineWidth = 0.7; g.strokeStyle = color; g.stroke(); g.strokeStyle = PAINT.paper;
      }
      g.lineWidth = 3;
      g.strokeText(text, ...put); g.fillText(text, ...put);
    };
    s.contacts.forEach((c, k) => write(String(c.number), [0, 1].map(i => mix(s.places[4 * k + i], f)),
      "bold 11px system-ui, sans-serif", PAINT.surface));
    s.bodies.forEach((body, b) => {
      const own = b ? s.shapes.filter(x => x.body === b && x.role === "wood").flatMap(x => x.points) : [];
      if (!own.length) return;
      const middle = k => 0.5 * (Math.min(...own.map(p => p[k])) + Math.max(...own.map(p => p[k])));
      write(body.name, placeOf(s, b, middle(0), middle(1), f), "12px system-ui, sans-serif", PAINT.ink);
    });
    g.textAlign = "start"; g.textBaseline = "alphabetic";
  }

  drawString({g, s, t, px, color}, order, magnified) {
    const string = s.string;
    if (!string) return;
    const w = stringShape(string, t), n = w ? w.length - 1 : 1, points = [];
    for (let i = 0; i <= n; i++) {
      const y = string.length * i / n, off = w ? magnified * w[i] : 0;
      points.push([0, 1].map(k => string.start[k] + y * string.along[k] - off * string.normal[k]));
      if (y > string.reach) break;
    }
    trace(g, points, false);
    g.strokeStyle = order ? color : PAINT.ink;
    g.lineWidth = (order ? 1.3 : 1.8) * px;
    g.stroke();
  }

  drawGround({g, s, px}) {
    const u = s.unit;
    for (const j of s.joints) if (j.ground) {
      const [x, y] = j.at;
      trace(g, [[x, y], [x - 4.2 * u, y - 7 * u], [x + 4.2 * u, y - 7 * u]], true);
      g.fillStyle = PAINT.paper; g.fill();
      g.strokeStyle = PAINT.ground; g.lineWidth = px; g.stroke();
    }
  }

  // Calls `paint` with the shapes of a body in its frame.
  inFrame(g, s, b, f, paint) {
    const own = s.shapes.filter(x => x.body === b);
    if (!own.length) return;
    const beam = s.beams.find(x => x.body === b), [x, y, angle] = poseOf(s, b, f);
    g.save();
    g.translate(x, y);
    g.rotate(angle);
    paint(own, shape => beam ? bendShape(beam, shape, f) : shape.points);
    g.restore();
  }

  drawBody({g, s, f, px}, b) {
    this.inFrame(g, s, b, f, (own, points) => {
      const fill = PAINT.fill(s.bodies[b].fill), share = this.tint ? this.tint[b] : 0;
      for (const [role, inside, ink] of [["wire", PAINT.wire, PAINT.wireInk], ["wood", fill, PAINT.ink],
        ["lead", PAINT.wire, PAINT.wireInk]]) {
        const chosen = own.filter(x => x.role === role);
        // All outlines before all fills, so that overlapping parts are one.
        g.strokeStyle = ink; g.lineWidth = 2.2 * px;
        for (const x of chosen) { trace(g, points(x), true); g.stroke(); }
        g.fillStyle = inside;
        for (const x of chosen) { trace(g, points(x), true); g.fill(); }
        if (share) {
          g.save();
          g.globalAlpha = Math.min(0.85, 0.15 + 0.7 * share);
          g.fillStyle = PAINT.gap;
          for (const x of chosen) { trace(g, points(x), true); g.fill(); }
          g.restore();
        }
      }
      g.fillStyle = b ? PAINT.felt : fill;
      for (const x of own) if (x.role === "pad") { trace(g, points(x), true); g.fill(); }
      g.strokeStyle = PAINT.surface; g.lineWidth = 1.4 * px;
      for (const x of own) if (x.role === "surface") { trace(g, points(x), false); g.stroke(); }
    });
  }

  // Outline of a body of another run: strokes, minus the insides.
  drawOutline({g, s, f, px, color}, b) {
    if (!b) return;
    const k = this.scratch.getContext("2d"), {width, height} = this.scratch;
    this.inFrame(k, s, b, f, (own, points) => {
      const solid = own.filter(x => x.role === "wood" || x.role === "wire" || x.role === "pad");
      k.strokeStyle = color; k.lineWidth = 2.6 * px;
      for (const x of solid) { trace(k, points(x), true); k.stroke(); }
      k.globalCompositeOperation = "destination-out";
      for (const x of solid) { trace(k, points(x), true); k.fill(); }
    });
    g.save();
    g.setTransform(1, 0, 0, 1, 0, 0);
    g.drawImage(this.scratch, 0, 0);
    g.restore();
    k.save();
    k.setTransform(1, 0, 0, 1, 0, 0);
    k.clearRect(0, 0, width, height);
    k.restore();
  }

  drawLinks({g, s, f, px, color}, order) {
    const u = s.unit;
    for (const strap of s.straps) {
      const a = placeOf(s, strap.a[0], strap.a[1], strap.a[2], f);
      const b = placeOf(s, strap.b[0], strap.b[1], strap.b[2], f);
      const gap = Math.hypot(b[0] - a[0], b[1] - a[1]);
      // A shallow parabola of sag h over a chord c is longer than it by 8 h^2 / (3 c).
      const sag = gap < strap.free
        ? Math.min(Math.sqrt(0.375 * gap * (strap.free - gap)), 0.5 * strap.free) : 0;
      g.beginPath();
      g.moveTo(a[0], a[1]);
      g.quadraticCurveTo(0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]) - 2 * sag, b[0], b[1]);
      g.strokeStyle = order ? color : "#CC79A7";
      g.lineWidth = (order ? 1.2 : 1.8) * px;
      g.stroke();
    }
    if (order) return;
    g.strokeStyle = PAINT.spring; g.lineWidth = 1.2 * px;
    for (const spring of s.springs) {
      const [x, y, angle] = poseOf(s, spring.body, f);
      g.save(); g.translate(x, y); g.rotate(angle);
      trace(g, spring.points, false); g.stroke(); g.restore();
    }
    for (const j of s.joints) {
      const [x, y] = placeOf(s, j.body, j.at[0], j.at[1], f);
      g.beginPath(); g.arc(x, y, 1.7 * u, 0, 7);
      g.fillStyle = PAINT.paper; g.fill();
      g.strokeStyle = PAINT.ink; g.lineWidth = 1.3 * px; g.stroke();
    }
  }

  // Lengths go with the root of the force, so that small ones stay visible.
  drawForces({g, s, f, px, color}, largest) {
    if (!(largest > 0)) return;
    const u = s.unit;
    g.strokeStyle = g.fillStyle = color;
    g.lineWidth = 2.2 * px;
    const arrow = (x, y, dx, dy) => {
      const l = Math.hypot(dx, dy), e = Math.min(4.5 * u, 0.5 * l) / l;
      g.beginPath(); g.moveTo(x, y);
      g.lineTo(x + dx * (1 - 0.6 * e), y + dy * (1 - 0.6 * e)); g.stroke();
      const hx = x + dx, hy = y + dy;
      trace(g, [[hx, hy], [hx - e * (dx - 0.4 * dy), hy - e * (dy + 0.4 * dx)],
                [hx - e * (dx + 0.4 * dy), hy - e * (dy - 0.4 * dx)]], true);
      g.fill();
    };
    s.contacts.forEach((contact, k) => {
      const force = mix(s.forces[k], f);
      if (!(force > 1e-3 * largest)) return;
      const [x, y, nx, ny] = [0, 1, 2, 3].map(i => mix(s.places[4 * k + i], f));
      const l = 45 * u * Math.sqrt(force / largest);
      for (const side of contact.sides) arrow(x, y, side * l * nx, side * l * ny);
    });
    if (!s.finger) return;
    const force = mix(s.finger.force, f);
    if (!(Math.abs(force) > 1e-3 * largest)) return;
    const l = 45 * u * Math.sqrt(Math.abs(force) / largest) * Math.sign(force);
    const [x, y] = placeOf(s, s.finger.body, s.finger.at[0], s.finger.at[1], f);
    const dx = l * s.finger.along[0], dy = l * s.finger.along[1];
    arrow(x - dx, y - dy, dx, dy);
  }
}

// The whole string from end to end, its displacement magnified to the height of the strip.
class StringStrip {
  constructor(canvas, runs) {
    this.canvas = canvas;
    this.setRuns(runs);
  }

  setRuns(runs) {
    this.runs = runs.filter(r => r.stage && r.stage.string && r.stage.string.modes);
    this.largest = Math.max(...this.runs.map(r => r.stage.string.modes.largest), 0);
    this.length = Math.max(...this.runs.map(r => r.stage.string.length), 0);
  }

  fit(dpr) {
    this.dpr = dpr;
    this.canvas.width = Math.max(1, Math.round(this.canvas.parentElement.clientWidth * dpr));
    this.canvas.height = Math.round(104 * dpr);
    this.canvas.style.height = "104px";
  }

  draw(now) {
    const g = this.canvas.getContext("2d");
    g.setTransform(this.dpr, 0, 0, this.dpr, 0, 0);
    const w = this.canvas.width / this.dpr, h = 104;
    g.clearRect(0, 0, w, h);
    g.font = "11px system-ui, sans-serif";
    g.fillStyle = PAINT.text;
    g.textBaseline = "top";
    g.fillText(`string, ${(this.length).toFixed(0)} mm from end to end, displacement to ±` +
               `${this.largest.toPrecision(3)} mm`, 4, 2);
    const X = share => 8 + (w - 16) * share, middle = 61, size = 38;
    g.strokeStyle = PAINT.axis; g.lineWidth = 1;
    g.beginPath(); g.moveTo(X(0), middle); g.lineTo(X(1), middle); g.stroke();
    for (const run of this.runs.filter(r => r.shown)) {
      const shape = stringShape(run.stage.string, run.time(now)), n = shape.length - 1;
      trace(g, Array.from(shape, (v, i) =>
        [X(i / n * run.stage.string.length / this.length), middle - size * v / this.largest]));
      g.strokeStyle = run.color; g.lineWidth = 1.6; g.stroke();
    }
  }
}
