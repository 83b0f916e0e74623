// Numbers of the page: little-endian integers and floats, as packing.py writes them, in base64 or beside
// the text of a message. Arrays that a worker made are passed through.

function bytes(text) {
  if (typeof text !== "string") return text;
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return new DataView(out.buffer);
}

// What a binary message of the server holds: its packed numbers lie after the text.
function unpackMessage(buffer) {
  const start = 4 + new DataView(buffer).getUint32(0, true);
  return JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, start - 4)),
    (key, value) => key === "data" ? new DataView(buffer, start + value[0], value[1]) : value);
}

// Columns (m arrays of n); -32768 is missing.
function columns(packed) {
  if (Array.isArray(packed)) return packed;
  const view = bytes(packed.data), {n, m} = packed, out = [];
  let at = 16 * m;
  for (let k = 0; k < m; k++) {
    const column = new Float64Array(n), low = view.getFloat64(8 * k, true), step = view.getFloat64(8 * (m + k), true);
    if (step === 0) column.fill(low);
    else for (let i = 0; i < n; i++, at += 2) {
      const whole = view.getInt16(at, true);
      column[i] = whole === -32768 ? NaN : low + step * (whole + 32767);
    }
    out.push(column);
  }
  return out;
}

// Lines of points [x, y].
function lines(packed) {
  if (Array.isArray(packed)) return packed;
  const view = bytes(packed.data);
  let at = 0;
  return packed.counts.map(count => Array.from({length: count}, () => {
    at += 8;
    return [view.getFloat32(at - 8, true), view.getFloat32(at - 4, true)];
  }));
}

function times(packed) {
  if (packed instanceof Float64Array) return packed;
  const view = bytes(packed.data), out = new Float64Array(view.byteLength / 4);
  for (let i = 0; i < out.length; i++) out[i] = packed.first + view.getFloat32(4 * i, true);
  return out;
}

// Last index whose time is not after t, and the share of the way to the next.
function locate(time, t) {
  let low = 0, high = time.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (time[middle] <= t) low = middle; else high = middle;
  }
  const span = time[high] - time[low];
  const share = span > 0 ? (t - time[low]) / span : 0;
  return [low, high, Math.max(0, Math.min(1, share))];
}

function mix(column, f) {
  return column[f[0]] + (column[f[1]] - column[f[0]]) * f[2];
}
