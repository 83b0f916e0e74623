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
    this.turned = this.values(turned);
    for (const [i, value] of this.turned) this.core.check(c.feltmb_set(this.it, i, value));
  }

  // Number of a path as it is turned.
  now(path) { const i = this.content.numbers[path]; return this.turned.get(i) ?? this.content.first[i]; }

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
  if (named.has("check")) [out.check_gap, out.check_gap_swing] = checkOf(machine, run) || [];
  if (run.lowest.length) out.key_travel = run.lowest[1] - run.lowest[2];
  return Object.fromEntries(Object.entries(out).filter(([, v]) => Number.isFinite(v)));
}

// ---------------------------------------------------------------- measurements

const CHECK_WINDOW = 0.01;  // of the mean distance in check [s]
const MOST_SWING = 1e-3;  // of a hammer in check that counts as at rest [m]
const LEVELS = [1.5, 2.5, 4, 7, 12, 20, 35];  // of pressed strikes [N]

const ofContact = (run, number, what) => run.values[`contact${String(number).padStart(2, "0")}.${what}`];

// Distance of hammer and undisplaced string [m].
function gapOf(machine, run) {
  const moved = run.values["string.strike"];
  return ofContact(run, machine.content.reading.strike, "compression").map((d, i) => -d - (moved ? moved[i] : 0));
}

// Mean and swing [m] of the distance of a hammer in check, as add_check in strikes.py; null: it is not held long enough.
function checkOf(machine, run) {
  const {time} = run, gap = gapOf(machine, run), forces = machine.content.check_contacts.map(n => ofContact(run, n, "force"));
  const held = time.map((_, i) => forces.reduce((sum, f) => sum + f[i], 0)), mean = v => v.reduce((a, b) => a + b, 0) / v.length;
  const part = (values, a, b) => values.filter((_, i) => time[i] >= a && time[i] <= b);
  const found = (a, b) => { const v = part(gap, a, b), [low, high] = spread(v); return [mean(v), high - low]; };
  const end = time.at(-1);
  if (mean(part(held, end - CHECK_WINDOW, end)) > 0) return found(end - CHECK_WINDOW, end);
  for (let last = time.length - 1; last >= 0; last--) {
    if (!(held[last] > 0)) continue;
    let first = last;
    while (first > 0 && held[first - 1] > 0) first--;
    const count = Math.trunc((time[last] - time[first]) / CHECK_WINDOW), windows = [];
    for (let k = count; k > 0; k--) windows.push(found(time[last] - k * CHECK_WINDOW, time[last] - (k - 1) * CHECK_WINDOW));
    if (count) return windows.reduce((best, w) => w[1] < best[1] ? w : best);
    last = first;
  }
  return null;
}

// Value of a regulation target [SI], as measuring.py; fails with the reason why there is none. `runs`: those that are
// there already, by name.
function measureOf(machine, step, runs) {
  const {strokes, reading, coordinates} = machine.content;
  const run = (name, stroke) => runs[name] ||= machine.run(stroke, {rate: 2000});
  const press = () => run(`press ${step.speed} ${step.travel}`, strokeOf({kind: "strike", speed: step.speed, travel: step.travel}, {}));
  const rest = () => Object.values(runs)[0] || press();  // all begin there
  const closest = () => spread(gapOf(machine, press()))[0];
  switch (step.measure) {
  case "rest_gap": return -ofContact(rest(), step.contact, "compression")[0];
  case "rest_force": return ofContact(rest(), step.contact, "force")[0];
  case "simulated_press": return closest();
  case "aftertouch": { const gap = gapOf(machine, press()); return -ofContact(press(), step.contact, "compression")[gap.indexOf(spread(gap)[0])]; }
  case "drop": return gapOf(machine, press()).at(-1) - closest();
  case "simulated_start": {
    const change = press().changes.find(c => c.contact === step.contact && c.closes && c.time > 0);
    if (!change) throw new Error(`contact ${step.contact} does not close in a press of ${1e3 * step.travel} mm`);
    return 1 - sampled(press().time, gapOf(machine, press()), [change.time])[0] / -ofContact(rest(), reading.strike, "compression")[0];
  }
  case "spring_force": {
    const {coordinate, name, arm} = step.spring, number = what => machine.now(`springs.${name}.${what}`);
    return Math.abs(number("stiffness") * (rest().values[coordinate][0] - number("rest_angle"))) / arm;
  }
  case "check_distance": {
    const found = checkOf(machine, run(step.stroke, strokes[step.stroke]));
    if (!found) throw new Error(`the backcheck does not hold the hammer after ${step.stroke}`);
    if (found[1] > MOST_SWING) throw new Error(`the hammer swings by ${(1e3 * found[1]).toPrecision(3)} mm in check at the end of ${step.stroke}`);
    return found[0];
  }
  default: throw new Error("this measurement needs feltmb live");
  }
}

// Rows of the regulation targets.
function targetRows(machine) {
  const runs = {};
  return machine.content.targets.map(step => {
    try {
      const value = measureOf(machine, step, runs), {target, low, high, factor} = step;
      const error = target !== null ? value - target : Math.min(0, value - (low ?? -Infinity)) || Math.max(0, value - (high ?? Infinity));
      return {...step, value: factor * value, holds: Math.abs(factor * error) <= (step.tolerance || 0), why: ""};
    } catch (error) { return {...step, value: null, holds: false, why: error.message}; }
  });
}

// Speeds [m/s] of key and hammer of strikes from pp to ff.
function speedRows(machine) {
  const rows = [];
  for (const level of LEVELS) {
    const run = machine.run({...strokeOf({kind: "press", force: level}, {}), duration: 0.45}, {rate: 5000});
    const {impact_time: hit, impact_speed: speed} = summaryOf(machine, run, nameEvents(run.changes, machine.content.events));
    const key = run.values[`${machine.content.reading.key_name}.vy`];
    if (hit !== undefined && key) rows.push([Math.max(...key.filter((_, i) => run.time[i] <= hit).map(v => -v)), speed, level]);
  }
  return {rows, missed: LEVELS.length - rows.length};
}

// ---------------------------------------------------------------- sound

const RATE = 44100;

// Force on the bridge at the rate of a sound, as sound.py.
function bridgeOf({time, values}) {
  const force = values["string.bridge_force"];
  if (!force) throw new Error("this mechanism has no string");
  return sampled(time, force, Float64Array.from({length: Math.max(2, Math.trunc((time.at(-1) - time[0]) * RATE))}, (_, i) => time[0] + i / RATE));
}

// 16 bit mono WAV file, scaled to the largest value.
function wavOf(sound) {
  const view = new DataView(new ArrayBuffer(44 + 2 * sound.length)), top = Math.max(...spread(sound.map(Math.abs)));
  const text = (at, letters) => [...letters].forEach((c, i) => view.setUint8(at + i, c.charCodeAt(0)));
  text(0, "RIFF"); text(8, "WAVEfmt "); text(36, "data");
  for (const [at, value] of [[4, 36 + 2 * sound.length], [16, 16], [24, RATE], [28, 2 * RATE], [40, 2 * sound.length]]) view.setUint32(at, value, true);
  for (const [at, value] of [[20, 1], [22, 1], [32, 2], [34, 16]]) view.setUint16(at, value, true);
  if (top > 0) sound.forEach((v, i) => view.setInt16(44 + 2 * i, Math.round(v / top * 32000), true));
  return view.buffer;
}

// Difference of two sounds, and its level relative to the first [dB].
function differenceOf(first, second) {
  const rest = Float64Array.from({length: Math.max(first.length, second.length)}, (_, i) => (first[i] ?? 0) - (second[i] ?? 0));
  const [power, left] = [first, rest].map(v => v.reduce((sum, x) => sum + x * x, 0));
  return [rest, left > 0 && power > 0 ? 10 * Math.log10(left / power) : NaN];
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
  // Forces change before things move: the ends of the motion are exact.
  const ends = [low, high].map(t => time.findIndex(s => s >= t)).filter(i => i >= 0);
  return [...new Set([...out, ...ends, time.length - 1])].sort((a, b) => a - b);
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

// ---------------------------------------------------------------- what was measured

const SI = {"": 1, 1: 1, m: 1, cm: 1e-2, mm: 1e-3, um: 1e-6, s: 1, ms: 1e-3, us: 1e-6, N: 1, mN: 1e-3, gf: 9.80665e-3,
  "m/s": 1, "mm/s": 1e-3, rad: 1, mrad: 1e-3, deg: Math.PI / 180, "rad/s": 1, "deg/s": Math.PI / 180};

// Length [m] of a pixel: "0.21 mm", or the distance of two points, "210 mm from 120 340 to 412 338".
function pixelSize(text) {
  const [, size, unit, ...at] = /^([\d.eE+-]+) *(\w+)(?: +from +(\S+) +(\S+) +to +(\S+) +(\S+))?$/.exec(text.trim()) || [];
  const [x, y, u, v] = at.map(Number), found = Number(size) * SI[unit] / (at[0] === undefined ? 1 : Math.hypot(u - x, v - y));
  if (!(found > 0 && found < Infinity)) throw new Error(`one pixel is ${text}: expected such as 0.21 mm, or 210 mm from 120 340 to 412 338`);
  return found;
}

// Times [s] and channels [SI] of a file, as its columns are read by `gap check`. Values are from the start where the
// origin is so.
function readColumns(file, {columns = {}, units = {}, scales = {}, origins = {}, frame_rate: rate, down}, outputs) {
  const channels = new Map();
  for (const [column, headed, raw] of file.columns) {
    const name = Object.keys(columns).find(c => columns[c] === column) ?? column, scale = scales[name] ?? scales[""];
    const given = units[name] || headed, known = outputs[name] || /^(time|t|frame|finger\.\w+)$/.test(name);
    const pixels = given === "px" || (!given && scale && outputs[name]), axis = /\.([xy])$/.exec(name)?.[1];
    if (!known) continue;
    if (pixels && !scale) throw new Error(`${file.name}: ${column} is in pixels: how large is one? Enter it under columns.`);
    const factor = pixels ? pixelSize(scale) : SI[given];
    if (factor === undefined) throw new Error(`${file.name}: unit ${given} of ${column} is unknown; known are px, ${Object.keys(SI).filter(u => u).join(", ")}`);
    const told = origins[name] ?? (pixels ? origins[""] : ""), place = told?.includes(",") ? told.split(",")[axis === "y" ? 1 : 0] : told;
    const fromStart = place === "start", zero = fromStart ? raw.find(Number.isFinite) : Number(place || 0);
    if (!Number.isFinite(zero)) throw new Error(`${file.name}: origin of ${name}: got ${told}, expected x,y in pixels, or start`);
    const sign = pixels && axis === "y" && (down ?? true) ? -1 : 1;
    channels.set(name, {values: raw.map(v => sign * factor * (v - zero)), fromStart});
  }
  const named = ["time", "t", "frame"].find(n => channels.has(n)), found = named && channels.get(named).values;
  const count = file.columns[0][2].length, time = rate ? Float64Array.from(found || {length: count}, (v, i) => (found ? v : i) / rate) : found;
  channels.delete(named);
  if (!time) throw new Error(`${file.name}: expected a column "time", or the frames a second under columns`);
  if (time.some((t, i) => !(i ? t > time[i - 1] : t >= 0))) throw new Error(`${file.name}: expected times that grow from 0 or later`);
  return {time, channels};
}
