// Simulations of a page by itself: the newest request is computed first, as in desk.py.

const AT_REST = 200;  // without changes before the complete run [ms]
const ROUGH = 1e-5;  // relative tolerance while something is turned
const LONGEST = 3;  // stroke [s]
// After what waits already; a timer would wait for 4 ms at least.
const channel = new MessageChannel();
const pause = wait => new Promise(go => {
  if (wait) { setTimeout(go, wait); return; }
  channel.port1.onmessage = go;
  channel.port2.postMessage(null);
});

class Bench {
  constructor(machine) {
    this.machine = machine;
    this.wanted = {};
    this.done = {quick: {}, full: {}, targets: {}, touch: {}, speeds: {}};
    this.extras = {targets: () => ({rows: targetRows(machine)}), touch: () => this.touch(), speeds: () => speedRows(machine)};
    this.sounds = [];
    this.files = new Map();
    this.asked = 0;
  }

  ask(message) {
    this.asked = performance.now();
    message.came = performance.now();
    if (message.do === "simulate") this.wanted[message.slot] = message;
    else if (message.do === "forget") delete this.wanted.b;
    else if (message.do === "measure") this.measuring = message;
    else if (message.do === "sound") this.sounds.push(message);
    else if (message.do === "add") this.files.set(message.file, message);
    else if (message.do === "remove") this.files.delete(message.file);
    this.work();
  }

  async work() {
    if (this.working) return;
    this.working = true;
    for (let wait = 0; wait !== null; wait = this.next()) await pause(wait);
    this.working = false;
  }

  // Computes what is first; time until the next [ms], null: nothing is left.
  next() {
    const slots = ["a", "b"].filter(slot => this.wanted[slot]);
    const open = kind => slots.find(slot => this.done[kind][slot] !== this.wanted[slot]);
    let slot = open("quick");
    if (slot) return this.picture(slot, "quick");
    if (this.measuring) return this.overlay();
    if (this.sounds.length) return this.sound(this.sounds.shift());
    const rest = AT_REST - (performance.now() - this.asked);
    if ((slot = open("full"))) return rest > 0 ? rest : this.picture(slot, "full");
    for (slot of slots) for (const kind of this.wanted[slot].extras)
      if (this.done[kind][slot] !== this.wanted[slot]) return this.extra(slot, kind);
    return null;
  }

  extra(slot, kind) {
    const asked = this.done[kind][slot] = this.wanted[slot];
    return this.answer({on: kind, slot, id: asked.id}, () => {
      this.machine.turn(asked.turned);
      return this.extras[kind]();
    });
  }

  // Posts what `work` finds, or why it fails.
  answer(message, work) {
    let found;
    try { found = work(); } catch (error) { found = {fault: error.message}; }
    postMessage({...message, ...found});
    return 0;
  }

  sound(asked) {
    return this.answer({on: "sound", id: asked.id}, () => {
      const heard = turned => bridgeOf(this.run({turned}, strokeOf(asked.playing, this.machine.content.strokes), {}));
      const own = heard(asked.turned);
      if (!asked.minus) return {wav: wavOf(own)};
      const [rest, level] = differenceOf(own, heard(asked.minus));
      return {wav: wavOf(rest), level};
    });
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
        rtol: ROUGH, rate: Math.min(Math.max((SAMPLES.quick - 2) / stroke.duration, 2000), 5000)} : {});
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
  touch() {
    const {key_name: key} = this.machine.content.reading;
    if (!key) throw new Error("the mechanism names no point of its key");
    const stroke = strokeOf({kind: "slow", speed: 0.01, travel: 0.012}, {}), middle = 0.5 * (stroke.time[1] + stroke.time[2]);
    const {time, values} = this.machine.run(stroke, {rate: 1000});
    const part = (name, keep) => [name, ...[values[`${key}.y`].map((y, _, all) => 1e3 * (all[0] - y)), values["finger.force"]]
      .map(v => v.filter((_, i) => keep(time[i])))];
    return {rows: [], curves: [part("press", t => t < middle), part("release", t => t >= middle)],
      notes: [`A finger moves at ${1e3 * 0.01} mm/s; weights and distances need feltmb touch.`]};
  }

  // Measured files with the model, on the channels that both have.
  overlay() {
    const asked = this.measuring, {outputs, strokes} = this.machine.content;
    this.measuring = null;
    return this.answer({on: "measured", id: asked.id}, () => {
      const records = [], rows = [], notes = [];
      for (const key of asked.files) {
        const file = this.files.get(key), {time, channels} = readColumns(file, asked.reading, outputs);
        const drive = ["finger.force", "finger.displacement"].find(n => channels.has(n));
        const stroke = drive ? {kind: drive === "finger.force" ? "force" : "motion", interpolation: "monotone", time,
          value: channels.get(drive).values, duration: time.at(-1)} : {...strokeOf(this.wanted.a.playing, strokes), duration: time.at(-1)};
        notes.push(`${file.name}: ${drive ? `played with its ${drive}` : "played with the stroke of the page"}`);
        const run = this.run(asked, stroke, {rate: 5000}), record = {name: file.name, time: Float64Array.from(time, t => 1e3 * t), channels: []};
        for (const [name, {values: measured, fromStart}] of channels) {
          if (!outputs[name] || name === drive) continue;
          const {factor, unit} = outputs[name], all = sampled(run.time, run.values[name], time), model = all.map(v => v - (fromStart ? all[0] : 0));
          const known = measured.map((v, i) => (v - model[i]) ** 2).filter(Number.isFinite);
          rows.push({record: file.name, channel: name, unit, rms: factor * Math.sqrt(known.reduce((a, b) => a + b, 0) / known.length), noise: null});
          record.channels.push({name, unit, values: [measured.map(v => factor * v), model.map(v => factor * v)]});
        }
        if (!record.channels.length) notes.push(`${file.name}: no column has the name of an output; choose one under columns`);
        records.push(record);
      }
      return {records, rows, notes};
    });
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
