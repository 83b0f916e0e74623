// Elements of a page, and the colors of what is drawn. Texts become text nodes only, never markup.

// Colors of what is drawn, by day and by night; `PAINT` is the set in use.
const DAY = {ink: "#3a3a3a", paper: "#fff", text: "#555", grid: "#e6e6e6", axis: "#ccc", cursor: "#444",
  ground: "#777", gap: "#D55E00", wire: "#8a8a8a", wireInk: "#555", felt: "rgba(199,123,116,.45)", surface: "#8e1b1b",
  spring: "#009E73", fill: f => f,
  runs: ["#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"],
  curves: ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"]};
const NIGHT = {ink: "#d8d4cc", paper: "#17191c", text: "#b4b4b4", grid: "#33373c", axis: "#555", cursor: "#bbb",
  ground: "#8a8a8a", gap: "#ff8c45", wire: "#a0a0a0", wireInk: "#ccc", felt: "rgba(214,120,110,.55)", surface: "#e88178",
  spring: "#2fc79a",
  runs: ["#ff8c45", "#56B4E9", "#2fc79a", "#e29ac2", "#E69F00", "#9fd3f2"],
  curves: ["#56B4E9", "#ff8c45", "#2fc79a", "#e29ac2", "#E69F00", "#9fd3f2"],
  // The same tint at a third of its lightness.
  fill: f => "#" + [1, 3, 5].map(i => Math.round(0.36 * parseInt(f.slice(i, i + 2), 16))
    .toString(16).padStart(2, "0")).join("")};
let PAINT = DAY;

function element(kind, options = {}, ...children) {
  const e = document.createElement(kind);
  for (const [key, value] of Object.entries(options)) {
    if (key === "class") e.className = value;
    else if (key.startsWith("on")) e.addEventListener(key.slice(2), value);
    else e.setAttribute(key, value);
  }
  e.append(...children);
  return e;
}

function choice(label, pairs, onchange) {
  const select = element("select", {"aria-label": label, onchange});
  for (const [value, text] of pairs) select.append(element("option", {value}, text));
  return select;
}

// Writes a text where it is another one: a text that is written costs a layout, though it is the same.
function put(e, text) {
  const now = e.firstChild;
  if (!now) { if (text !== "") e.append(text); }
  else if (now.data !== text) now.data = text;
}
