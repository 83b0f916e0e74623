// The page by itself: a worker of the browser simulates, with what is in the file.

class Local {
  // What needs the server.
  static lacks = new Set(["files", "regulation", "diagnosis"]);

  constructor(heard, changed) {
    this.up = false;
    this.heard = heard;
    this.count = 0;
    const content = JSON.parse(find("content").textContent);
    const address = URL.createObjectURL(new Blob([find("engine").textContent], {type: "text/javascript"}));
    this.worker = new Worker(address);
    this.worker.onmessage = ({data}) => {
      if (data.on === "sound") { this.hear(data); return; }
      if (data.on !== "ready") { heard(data); return; }
      this.up = true;
      changed(true);
      heard(content.hello);
    };
    this.worker.onerror = e => heard({on: "refused", text: `the worker failed: ${e.message}`});
    this.worker.postMessage({do: "open", module: bytes(find("module").textContent.trim()).buffer, content});
  }

  send(message) {
    this.worker.postMessage(message);
    return true;
  }

  // A table of numbers as text; a name of a column may have its unit in brackets.
  async add(file) {
    const rows = (await file.text()).split(/\r?\n/).filter(line => line.trim() && !line.startsWith("#"));
    const mark = ["\t", ";", ","].find(m => rows[0]?.includes(m)) || /\s+/;
    const table = rows.map(line => line.split(mark).map(cell => cell.trim().replace(/^"|"$/g, "")));
    const head = (table.shift() || []).map(name => /^(.*?)\s*(?:[[(]\s*([^\])]*)[\])])?$/.exec(name).slice(1));
    // With semicolons the comma is that of decimals.
    const number = cell => cell ? Number(mark === ";" ? cell.replace(",", ".") : cell) : NaN;
    if (head.length < 2 || !table.length || table.some(row => Number.isNaN(number(row[0] ?? ""))))
      throw new Error(`${file.name}: expected a table of numbers (CSV) with a line of names, a column "time" first`);
    const entry = {file: `r${++this.count}`, name: file.name, columns: head.map(([name, unit = ""]) => [name, unit])};
    this.send({do: "add", file: entry.file, name: entry.name, columns: head.map(([name, unit = ""], k) =>
      [name, unit, Float64Array.from(table, row => number(row[k] ?? ""))])});
    return entry;
  }

  // The sound of what a message describes.
  sound(message) {
    return new Promise((good, bad) => {
      this.hear = found => found.fault ? bad(new Error(found.fault)) : good(found);
      this.send({do: "sound", ...message});
    });
  }

  async remove(key) { this.send({do: "remove", file: key}); }
}

window.feltmbLive = new Live(Local);
