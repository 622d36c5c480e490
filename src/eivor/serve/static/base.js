// -- elements: text goes in as text only -------------------------------------------------------------------
const SVG = "http://www.w3.org/2000/svg";
const LONGEST = 120;
const LONGEST_SENTENCE = 600;
const root = document.documentElement;
const found = (name) => document.getElementById(name);
const embedded = (name) => JSON.parse(found(name).textContent);
const SHAPES = embedded("shapes");

function filled(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes || {})) {
    if (typeof value === "function") element.addEventListener(name, value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.filter((one) => one !== null && one !== undefined && one !== ""));
  return element;
}
const make = (tag, attributes, ...children) => filled(document.createElement(tag), attributes, children);
const draw = (tag, attributes, ...children) => filled(document.createElementNS(SVG, tag), attributes, children);

// What a screen would not show, or would turn the reading direction, is made visible.
const visible = (text) => String(text).replace(/[\p{C}\p{Zl}\p{Zp}]/gu, (one) => `\\u{${one.codePointAt(0).toString(16)}}`);
const cut = (text, longest) => (text.length > longest ? `${text.slice(0, longest - 1)}…` : text);
const named = (name) => cut(visible(cut(String(name), 2 * LONGEST)), LONGEST);
// Options of the command line by the controls that are here for them.
const PLAN = "“Plan of the next flight” below Downloads";
const CONTROLS = { model: "Model", method: "Method", lag: "Lag known from elsewhere", input: "Input", "input-map": "Input map", vehicle: "Vehicle", map: "Channel map", compare: "Every method side by side", mass: "Mass", prior: "Known from elsewhere" };
const onPage = (text) => text.replace(/eivor plan proposes for this result \(--json FIT\.json\)/g, `the ${PLAN} proposes`).replace(/--([a-z-]+)/g, (flag, name) => (name in CONTROLS ? `“${CONTROLS[name]}”` : flag));
const said = (text) => cut(visible(cut(onPage(String(text)), 2 * LONGEST_SENTENCE)), LONGEST_SENTENCE);

function shape(name) {
  return draw("svg", { viewBox: "0 0 20 20", class: "shape", "aria-hidden": "true" }, draw("circle", { cx: 10, cy: 10, r: 8.6 }), draw("path", { d: SHAPES[name] || "" }));
}
const SHOWN = { weak: "rough", provisional: "not identified (provisional)", refused: "not identified" };
const badge = (status, words) => make("span", { class: `badge ${status}` }, shape(status), words || SHOWN[status] || status);
const button = (words, click, more) => make("button", { type: "button", click, ...more }, words);
const seconds = (number) => `${number.toFixed(1)} s`;

function announce(words) {
  found("status").textContent = words;
}

// Hides or shows; the focus goes on to what is there where it would be lost.
function shown(element, wanted) {
  const lost = !wanted && element.contains(document.activeElement);
  element.hidden = !wanted;
  if (lost) element.parentElement.querySelector("button:not([hidden])")?.focus();
}
