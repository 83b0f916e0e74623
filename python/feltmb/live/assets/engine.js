// A mechanism in the module of the core, and its runs as pictures of the live page: what desk.py and
// pictures.py do for the server. Runs in a worker of the page, and in Node.

const INTERPOLATIONS = ["linear", "monotone", "spline"];
const FRAMES = {quick: 120, full: 500}, SAMPLES = {quick: 900, full: 4000}, STRING = 300;
const ONE_STRIKE = 6e-3;  // contacts with the string within this time are one strike [s]

// ---------------------------------------------------------------- module

// C functions over the memory of the module.
class Core {
  // `bytes`: of the module.
  static async load(bytes) {
    const core = new Core(), module = await WebAssembly.compile(bytes), imports = {};
    const known = {
      clock_time_get: (_clock, _precision, at) => {
        new DataView(core.memory.buffer).setBigUint64(at, BigInt(Math.round(1e6 * performance.now())), true);
        return 0;
      },
      proc_exit: code => { throw new Error(`the module ended with ${code}`); },
    };
    // Files and environment: there are none (8: no such descriptor).
    for (const {module: from, name, kind} of WebAssembly.Module.imports(module))
      if (kind === "function") (imports[from] ||= {})[name] = known[name] || (() => name.startsWith("fd_") ? 8 : 0);
    core.c = (await WebAssembly.instantiate(module, imports)).exports;
    core.memory = core.c.memory;
    core.c._initialize?.();
    return core;
  }

  // Numbers at a place, copied: the memory moves when it grows.
  numbers(at, count) { return new Float64Array(this.memory.buffer, at, count).slice(); }

  text(at) {
    const bytes = new Uint8Array(this.memory.buffer, at);
    return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
  }

  // Calls `work` with the places of texts and lists of numbers, which are freed afterwards.
  with(values, work) {
    const places = values.map(value => {
      const bytes = typeof value === "string" ? new TextEncoder().encode(value + "\0") :
        new Uint8Array(Float64Array.from(value).buffer);
      const at = this.c.malloc(bytes.length + 8);
      new Uint8Array(this.memory.buffer).set(bytes, at);
      return at;
    });
    try { return work(...places); } finally { places.forEach(at => this.c.free(at)); }
  }

  // What a function returned, unless it failed.
  check(found) {
    if (!found) throw new Error(this.text(this.c.feltmb_fault()));
    return found;
  }
}

class Machine {
  // `content`: as page.py writes it.
  constructor(core, content) {
    this.core = core;
    this.content = content;
    const {c} = core;
    const {string} = this.look = content.hello.look;
    this.modes = string?.shapes ? columns(string.shapes) : [];
    this.it = core.check(core.with([content.archive], c.feltmb_create));
    for (const [, point, [x, y], travel] of content.points) c.feltmb_watch_point(this.it, point, x, y, travel);
    const {strike, key} = content.reading;
    if (strike !== null) c.feltmb_watch_peak(this.it, strike);
    if (key !== null) c.feltmb_watch_lowest(this.it, key);
  }

  // Numbers by place, of all knobs and numbers that are turned: factors first, then summands.
  values(turned) {
    const {knobs, numbers, first} = this.content, factors = new Map(), sums = new Map(), out = new Map();
    for (const [name, size] of Object.entries(turned.knobs)) {
      if (!knobs[name]) throw new Error(`knob ${name} is unknown for this mechanism`);
      for (const [i, scale, exp, add] of knobs[name]) {
        factors.set(i, (factors.get(i) ?? 1) * (1 + scale * size) * Math.exp(exp * size));
        sums.set(i, (sums.get(i) ?? 0) + add * size);
      }
    }
    for (const [i, factor] of factors) out.set(i, first[i] * factor + sums.get(i));
    for (const [path, value] of Object.entries(turned.numbers)) {
      if (numbers[path] === undefined) throw new Error(`${path} is no number of this mechanism`);
      out.set(numbers[path], value);
    }
    return out;
  }

  turn(turned) {
    const {c} = this.core;
    c.feltmb_reset(this.it);
    for (const [i, value] of this.values(turned)) this.core.check(c.feltmb_set(this.it, i, value));
  }

  // A stroke: samples of all outputs by name, events, string.
  run(stroke, {duration = stroke.duration, rtol = 1e-6, rate = 10000} = {}) {
    const {core, it} = this, {c} = core;
    core.check(core.with([stroke.kind, stroke.time, stroke.value], (kind, time, value) =>
      c.feltmb_run(it, kind, INTERPOLATIONS.indexOf(stroke.interpolation), stroke.time.length, time, value,
        stroke.oscillation_amplitude || 0, stroke.oscillation_frequency || 0, duration, rtol, rate)));
    const time = this.read("time"), data = this.read("data"), n = time.length;
    this.outputs ||= this.names("outputs");
    this.contacts ||= this.names("contacts").map(([name, number]) => ({name, number: Number(number)}));
    const column = (table, width, k) => Float64Array.from({length: n}, (_, i) => table[width * i + k]);
    const values = {}, width = 4 + 2 * this.contacts.length, rows = this.read("events"), eta = this.read("eta");
    this.outputs.forEach(([name], k) => { values[name] = column(data, this.outputs.length, k); });
    const striker = this.content.reading.striker;
    if (striker) {
      const [x, y] = [values[`${striker.point}.vx`], values[`${striker.point}.vy`]], [a, b] = striker.direction;
      values[`${striker.point}.speed`] = x.map((v, i) => (a * v + b * y[i]) / Math.hypot(a, b));
    }
    const changes = Array.from({length: rows.length / width}, (_, i) => {
      const [t, contact, monitor, direction, ...of] = rows.subarray(width * i, width * (i + 1));
      return {time: t, contact: monitor < 0 ? contact : null, monitor: this.content.points[monitor]?.[0], closes: direction > 0,
        compression: of.slice(0, this.contacts.length), approach: of.slice(this.contacts.length)};
    });
    const modes = eta.length / n;
    return {time, values, changes, eta: Array.from({length: modes}, (_, k) => column(eta, modes, k)),
      peaks: this.read("peaks"), lowest: this.read("lowest"), steps: this.read("counts")[0]};
  }

  read(name) {
    return this.core.with([name, [0]], (at, count) => {
      const place = this.core.c.feltmb_read(this.it, at, count);
      const fault = this.core.text(this.core.c.feltmb_fault());  // an empty list may lie at 0
      if (fault) throw new Error(fault);
      return this.core.numbers(place, new Int32Array(this.core.memory.buffer, count, 1)[0]);
    });
  }

  names(name) {
    return this.core.text(this.core.check(this.core.with([name], at => this.core.c.feltmb_names(this.it, at))))
      .split("\n").slice(0, -1).map(line => line.split("\t"));
  }

  // Rows of numbers for poses, rows of coordinates.
  poses(q) {
    return this.core.with([q.flat(), [0]], (at, count) => {
      const place = this.core.check(this.core.c.feltmb_poses(this.it, q.length, at, count));
      const all = this.core.numbers(place, new Int32Array(this.core.memory.buffer, count, 1)[0]);
      return q.map((_, i) => all.subarray(i * all.length / q.length, (i + 1) * all.length / q.length));
    });
  }
}

// ---------------------------------------------------------------- readings

const spread = v => {
  let low = Infinity, high = -Infinity;
  for (const x of v) { if (x < low) low = x; if (x > high) high = x; }
  return [low, high];
};

// Values at other times, between samples by a straight line.
function sampled(time, values, at) {
  let i = 0;
  return Float64Array.from(at, t => {
    while (i < time.length - 2 && time[i + 1] <= t) i++;
    const share = Math.max(0, Math.min(1, (t - time[i]) / (time[i + 1] - time[i])));
    return values[i] + share * (values[i + 1] - values[i]);
  });
}

// Times in which forces and motions change, with a margin [s].
function busyWindow({time, values}) {
  const moving = Object.keys(values).filter(n => /^contact\d+\.force$|^finger\.force$|^.+\.[xy]$/.test(n))
    .map(n => [values[n], spread(values[n])]).map(([v, [low, high]]) => [v, high - low]);
  const largest = Math.max(1e-30, ...moving.map(m => m[1]));
  let first = time.length, last = -1;
  for (const [v, size] of moving.filter(m => m[1] > 1e-6 * largest)) {
    first = Math.min(first, v.findIndex(x => Math.abs(x - v[0]) > 0.02 * size));
    last = Math.max(last, v.findLastIndex(x => Math.abs(x - v.at(-1)) > 0.02 * size));
  }
  if (last < 0) return [time[0], time.at(-1)];
  const span = Math.max(time[last] - time[first], 1e-3);
  return [Math.max(time[0], time[first] - 0.06 * span), Math.min(time.at(-1), time[last] + 0.06 * span)];
}

// Indices of the changes that are the named events, by the rules of the mechanism file: as events.py.
function nameEvents(changes, rules) {
  const found = new Map(), visiting = new Set();
  const concerns = (c, name, r) => r.point !== null ? c.monitor === name : r.contacts.includes(c.contact);
  const resolve = name => {
    if (found.has(name)) return found.get(name);
    const r = rules[name];
    if (!r || visiting.has(name)) return null;
    visiting.add(name);
    if (r.unless !== null && resolve(r.unless) !== null) return null;
    let low = -Infinity, high = Infinity;
    if (r.after !== null) {
      const i = resolve(r.after);
      if (i === null) return null;
      low = changes[i].time;
      if (r.within !== null) high = low + r.within;
    }
    if (r.before !== null) {
      const i = resolve(r.before);
      if (i === null) return null;
      high = Math.min(high, changes[i].time);
    }
    const forward = r.point !== null || r.change === "closes";
    const fits = c => low <= c.time && c.time <= high && concerns(c, name, r) && c.closes === forward;
    const i = r.which === "first" ? changes.findIndex(fits) : changes.findLastIndex(fits);
    if (i < 0) return null;
    // The last opening before an event counts only if the contact then stayed open.
    if (r.which === "last" && r.before !== null && r.contacts.length && changes.some(c =>
      c.contact === changes[i].contact && c.closes !== changes[i].closes && changes[i].time < c.time && c.time <= high)) return null;
    found.set(name, i);
    return i;
  };
  for (const name of Object.keys(rules)) { visiting.clear(); resolve(name); }
  return found;
}

// Numbers of the first strike, SI units, as in `feltmb stroke --json`.
function summaryOf(machine, run, named) {
  const {strike} = machine.content.reading, {changes} = run, out = {};
  for (const [name, i] of named) out[`${name}_time`] = changes[i].time;
  const k = machine.contacts.findIndex(c => c.number === strike && strike !== null);
  const on = k < 0 ? -1 : changes.findIndex(c => c.contact === strike && c.closes);
  if (on >= 0) {
    out.impact_time = changes[on].time;
    out.impact_speed = changes[on].approach[k];
    const off = changes.findLast(c => c.contact === strike && !c.closes && c.time > changes[on].time &&
      c.time <= changes[on].time + ONE_STRIKE);
    if (off) {
      out.rebound_speed = -off.approach[k];
      out.impact_duration = off.time - changes[on].time;
    }
  }
  if (run.peaks.length) [, out.max_impact_force, out.max_impact_force_time] = run.peaks;
  if (k >= 0 && named.has("let_off")) out.let_off_gap = -changes[named.get("let_off")].compression[k];
  if (run.lowest.length) out.key_travel = run.lowest[1] - run.lowest[2];
  return Object.fromEntries(Object.entries(out).filter(([, v]) => Number.isFinite(v)));
}

// ---------------------------------------------------------------- pictures

// Indices of frames, closer together during fast motion.
function frameIndices(run, coordinates, [low, high], count) {
  const {time, values} = run, moved = new Float64Array(time.length);
  for (const v of coordinates.map(n => values[n])) {
    const [least, most] = spread(v);
    if (most > least) for (let i = 1; i < v.length; i++) moved[i] += Math.abs(v[i] - v[i - 1]) / (most - least);
  }
  for (let i = 1; i < time.length; i++) {
    const step = time[i] - time[i - 1];
    if (time[i] >= low && time[i] <= high) moved[i] += 4 * step / Math.max(high - low, 1e-6);
    moved[i] += moved[i - 1] + 0.2 * step / Math.max(time.at(-1) - time[0], 1e-6);
  }
  const most = Math.min(count, time.length), out = [];
  for (let i = 0, k = 0; k < most - 1; k++) {
    while (moved[i] < moved[0] + k * (moved.at(-1) - moved[0]) / (most - 1)) i++;
    if (out.at(-1) !== i) out.push(i);
  }
  if (out.at(-1) !== time.length - 1) out.push(time.length - 1);
  return out;
}

function every(count, most) {
  const stride = Math.max(1, Math.ceil(count / most)), out = [];
  for (let i = 0; i < count; i += stride) out.push(i);
  if (out.at(-1) !== count - 1) out.push(count - 1);
  return out;
}

const take = (values, some, factor = 1) => Float64Array.from(some, i => factor * values[i]);

// Largest displacement of the string [mm], at some of its points.
function deflection(shapes, eta) {
  let largest = 0;
  for (let i = 0; i < eta[0].length; i++)
    for (let y = 0; y < shapes[0].length; y += 8) largest = Math.max(largest, Math.abs(shapes.reduce((w, s, k) => w + s[y] * eta[k][i], 0)));
  return largest;
}

function stageOf(machine, run, busy, quality, turned) {
  const {content, look} = machine, {order} = content, {time, values} = run;
  const some = frameIndices(run, content.coordinates, busy, FRAMES[quality]);
  const rows = machine.poses(some.map(i => content.coordinates.map(n => values[n][i])));
  const column = (k, factor) => Float64Array.from(rows, row => factor * row[k]);
  const poses = order.bodies.flatMap(at => at < 0 ? [0, 1, 2].map(() => new Float64Array(some.length)) :
    [column(3 * at, 1e3), column(3 * at + 1, 1e3), column(3 * at + 2, 1)]);
  const force = n => values[`contact${String(n).padStart(2, "0")}.force`];
  const numbers = look.contacts.map(c => c.number).filter(n => spread(force(n))[1] > 1e-6);
  const first = 3 * order.names, line = first + 4 * order.numbers.length;
  const places = numbers.flatMap(n => [1e3, 1e3, 1, 1].map((f, k) => column(first + 4 * order.numbers.indexOf(n) + k, f)));
  const finger = values["finger.force"] && take(values["finger.force"], some);
  const forces = numbers.map(n => take(force(n), some).map(f => Math.max(f, 0)));
  const peaks = [...forces, ...finger ? [finger.map(Math.abs)] : []].map(v => spread(v)[1]);
  const when = every(time.length, STRING), {modes} = machine, eta = modes.length ? run.eta.map(v => take(v, when, 1e3)) : [];
  return {time: take(time, some, 1e3), poses, numbers, places, forces, largest: Math.max(0, ...peaks),
    lines: look.beams.map((_, k) => Array.from({length: 50}, (_, i) => column(line + 50 * k + i, 1e3))),
    finger: finger ? [finger] : null, shifts: shiftsOf(machine, turned),
    modes: eta.length ? {time: take(time, when, 1e3), eta, which: [...eta.keys()], largest: deflection(modes, eta),
      step: 1e3 * (time[1] - time[0]) * (when[1] - when[0])} : null};
}

// Shifts x, y of surfaces [mm], in the frame of their body.
function shiftsOf(machine, turned) {
  const {paths, first} = machine.content, out = {};
  for (const [i, value] of machine.values(turned)) {
    const found = /^surfaces\.(.+)\.point\.([xy])$/.exec(paths[i]);
    if (found) (out[found[1]] ||= [0, 0])[found[2] === "x" ? 0 : 1] = 1e3 * (value - first[i]);
  }
  return out;
}

// A run for the page, in practical units.
function pictureOf(machine, run, shown, quality, turned) {
  const {content} = machine, {time, values} = run, busy = busyWindow(run), some = every(time.length, SAMPLES[quality]);
  const named = nameEvents(run.changes, content.events);
  const outputs = shown.filter(n => values[n] && content.outputs[n]).map(name => ({name, ...content.outputs[name]}));
  return {quality, first: 1e3 * time[0], last: 1e3 * time.at(-1), busy: busy.map(t => 1e3 * t),
    events: [...named].map(([name, i]) => [1e3 * run.changes[i].time, name.replace(/_/g, " ")]).sort((a, b) => a[0] - b[0]),
    time: take(time, some, 1e3), values: outputs.map(o => take(values[o.name], some, o.factor)),
    outputs, stage: stageOf(machine, run, busy, quality, turned),
    summary: summaryOf(machine, run, named), energy: {}, warnings: []};
}

// ---------------------------------------------------------------- what is played

const START = 0.02;  // of the strokes of the page [s]

// As Playing in states.py.
function strokeOf(p, strokes) {
  const table = (kind, interpolation, time, value, duration) => ({kind, interpolation, time, value, duration});
  if (p.kind === "packaged") {
    if (!strokes[p.name]) throw new Error(`stroke ${p.name} is not in this page`);
    return strokes[p.name];
  }
  if (p.kind === "free") return table("force", "linear", [0, p.duration], [0, 0], p.duration);
  if (p.kind === "press") return table("force", "linear", [START, START + 0.02], [0, p.force], 0.3);
  if (p.kind === "planned") return table("force", "monotone", p.time, p.value, p.duration);
  if (p.kind === "drawn") {
    if (p.time.length < 2) throw new Error("a drawn stroke needs 2 or more knots");
    const force = p.drawn === "force";
    return table(force ? "force" : "motion", force ? "linear" : "monotone", p.time, p.value, p.time.at(-1) + 0.15);
  }
  if (p.kind === "repeat") {
    const period = 1 / p.rate, time = [], value = [];
    for (let i = 0; i < p.count; i++) {
      const t = i * period + START;
      time.push(t, t + 0.01, t + 0.01 + 0.25 * period, t + 0.01 + 0.5 * period);
      value.push(0, p.force, p.force, 0);
    }
    if (START + 0.01 + 0.5 * period >= START + period) throw new Error(`${p.rate} strikes a second overlap`);
    return table("force", "linear", time, value, p.count * period);
  }
  const end = START + p.travel / p.speed, slow = p.kind === "slow";
  const time = [START, end, ...slow ? [end + 0.05, 2 * end + 0.05 - START] : []];
  return table("motion", "linear", time, slow ? [0, p.travel, p.travel, 0] : [0, p.travel], time.at(-1) + 0.1);
}
