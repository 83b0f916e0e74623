// Simulations of a page by itself: the newest request is computed first, as in desk.py.

const AT_REST = 200;  // without changes before the complete run [ms]
const LONGEST = 3;  // stroke [s]
const SI = {"": 1, 1: 1, m: 1, cm: 1e-2, mm: 1e-3, um: 1e-6, s: 1, ms: 1e-3, us: 1e-6, N: 1, mN: 1e-3, gf: 9.80665e-3,
  "m/s": 1, "mm/s": 1e-3, rad: 1, mrad: 1e-3, deg: Math.PI / 180, "rad/s": 1, "deg/s": Math.PI / 180};

class Bench {
  constructor(machine) {
    this.machine = machine;
    this.wanted = {};
    this.done = {quick: {}, full: {}, touch: {}};
    this.files = new Map();
    this.asked = 0;
  }

  ask(message) {
    this.asked = performance.now();
    message.came = performance.now();
    if (message.do === "simulate") this.wanted[message.slot] = message;
    else if (message.do === "forget") delete this.wanted.b;
    else if (message.do === "measure") this.measuring = message;
    else if (message.do === "add") this.files.set(message.file, message);
    else if (message.do === "remove") this.files.delete(message.file);
    this.work();
  }

  async work() {
    if (this.working) return;
    this.working = true;
    for (let wait = 0; wait !== null; wait = this.next()) await new Promise(go => setTimeout(go, wait));
    this.working = false;
  }

  // Computes what is first; time until the next [ms], null: nothing is left.
  next() {
    const slots = ["a", "b"].filter(slot => this.wanted[slot]);
    const open = kind => slots.find(slot => this.done[kind][slot] !== this.wanted[slot]);
    let slot = open("quick");
    if (slot) return this.picture(slot, "quick");
    if (this.measuring) return this.overlay();
    const rest = AT_REST - (performance.now() - this.asked);
    if ((slot = open("full"))) return rest > 0 ? rest : this.picture(slot, "full");
    slot = slots.find(s => this.wanted[s].extras.includes("touch") && this.done.touch[s] !== this.wanted[s]);
    return slot ? this.touch(slot) : null;
  }

  run(asked, stroke, options) {
    if (stroke.duration > LONGEST) throw new Error(`the stroke lasts ${stroke.duration} s, expected ${LONGEST} s at most`);
    this.machine.turn(asked.turned);
    return this.machine.run(stroke, options);
  }

  picture(slot, quality) {
    const asked = this.wanted[slot], begin = performance.now();
    this.done[quality][slot] = asked;
    try {
      const stroke = strokeOf(asked.playing, this.machine.content.strokes), quick = quality === "quick";
      const run = this.run(asked, stroke, quick ? {duration: Math.min(stroke.duration, asked.until ?? Infinity),
        rate: Math.min(Math.max((SAMPLES.quick - 2) / stroke.duration, 2000), 5000)} : {});
      const simulated = performance.now(), picture = pictureOf(this.machine, run, asked.shown, quality, asked.turned);
      picture.last = 1e3 * stroke.duration;
      picture.milliseconds = {queue: begin - asked.came, simulation: simulated - begin, description: performance.now() - simulated};
      postMessage({on: "run", slot, id: asked.id, run: picture, set: this.settings(asked.turned)});
    } catch (error) {
      this.done.full[slot] = asked;
      postMessage({on: "fault", slot, id: asked.id, faults: error.message.split("\n")});
    }
    return 0;
  }

  // What is turned, for the command line.
  settings(turned) {
    const {paths, units} = this.machine.content, out = {};
    for (const [i, value] of this.machine.values(turned)) out[paths[i]] = `${+value.toPrecision(12)} ${units[i]}`.trim();
    return out;
  }

  // Force over the travel of the key in a slow press and release.
  touch(slot) {
    const asked = this.wanted[slot], {key_name: key} = this.machine.content.reading;
    this.done.touch[slot] = asked;
    try {
      if (!key) throw new Error("the mechanism names no point of its key");
      const stroke = strokeOf({kind: "slow", speed: 0.01, travel: 0.012}, {}), middle = 0.5 * (stroke.time[1] + stroke.time[2]);
      const {time, values} = this.run(asked, stroke, {rate: 1000});
      const part = (name, keep) => [name, ...[values[`${key}.y`].map((y, _, all) => 1e3 * (all[0] - y)), values["finger.force"]]
        .map(v => v.filter((_, i) => keep(time[i])))];
      postMessage({on: "touch", slot, id: asked.id, rows: [], curves: [part("press", t => t < middle), part("release", t => t >= middle)],
        notes: [`A finger moves at ${1e3 * 0.01} mm/s; weights and distances need feltmb touch.`]});
    } catch (error) { postMessage({on: "touch", slot, id: asked.id, fault: error.message}); }
    return 0;
  }

  // Measured files with the model, on the channels that both have.
  overlay() {
    const asked = this.measuring, records = [], rows = [], notes = [];
    this.measuring = null;
    try {
      for (const key of asked.files) {
        const file = this.files.get(key), channels = new Map(), {columns, units} = asked.reading;
        for (const [name, unit, values] of file.columns) {
          const told = Object.entries(columns || {}).find(([, c]) => c === name), channel = told ? told[0] : name;
          const factor = SI[units?.[channel] ?? unit];
          if (factor === undefined) throw new Error(`${file.name}: unit ${unit} of ${name} is unknown; known are ${Object.keys(SI).filter(u => u).join(", ")}`);
          channels.set(channel, values.map(v => factor * v));
        }
        const time = channels.get("time") || channels.get("t");
        if (!time || time.some((t, i) => !(i ? t > time[i - 1] : t >= 0)))
          throw new Error(`${file.name}: expected a column "time" whose values grow from 0 or later`);
        const drive = ["finger.force", "finger.displacement"].find(n => channels.has(n));
        const stroke = drive ? {kind: drive === "finger.force" ? "force" : "motion", interpolation: "monotone", time: [...time],
          value: [...channels.get(drive)], duration: time.at(-1)} : {...this.wanted.a && strokeOf(this.wanted.a.playing, this.machine.content.strokes), duration: time.at(-1)};
        notes.push(`${file.name}: ${drive ? `played with its ${drive}` : "played with the stroke of the page"}`);
        const run = this.run(asked, stroke, {rate: 5000}), record = {name: file.name, time: time.map(t => 1e3 * t), channels: []};
        for (const [name, measured] of channels) {
          const output = this.machine.content.outputs[name];
          if (!output || name === drive || name === "time") continue;
          const model = sampled(run.time, run.values[name], time), {factor, unit} = output;
          const known = measured.map((v, i) => (v - model[i]) ** 2).filter(Number.isFinite);
          rows.push({record: file.name, channel: name, unit, rms: factor * Math.sqrt(known.reduce((a, b) => a + b, 0) / known.length), noise: null});
          record.channels.push({name, unit, values: [measured.map(v => factor * v), model.map(v => factor * v)]});
        }
        if (!record.channels.length) notes.push(`${file.name}: no column has the name of an output; choose one under columns`);
        records.push(record);
      }
      postMessage({on: "measured", id: asked.id, records, rows, notes});
    } catch (error) { postMessage({on: "measured", id: asked.id, fault: error.message}); }
    return 0;
  }
}

let bench = null;
onmessage = async ({data}) => {
  if (data.do !== "open") { bench.ask(data); return; }
  try {
    bench = new Bench(new Machine(await Core.load(data.module), data.content));
    postMessage({on: "ready"});
  } catch (error) { postMessage({on: "refused", text: `this browser cannot run the module: ${error.message}`}); }
};
