// -- several flights side by side --------------------------------------------------------------------------
const FOREST = { width: 440, row: 44, foot: 44, side: 14, letter: 7.4 };

function comparisonOf(several) {
  const names = [...new Map(several.flatMap((flight) => flight.report.verdict.readings.map((one) => [one.name, one]))).entries()];
  const reported = (flight, name) => flight.report.verdict.readings.find((one) => one.name === name);
  const titles = names.map(([, one]) => `${one.symbol}${one.unit ? ` [${one.unit}]` : ""}`);
  const rows = several.map((flight) => {
    const cells = names.map(([name], place) => {
      const one = reported(flight, name);
      return make("td", { class: "strong", "data-title": titles[place] }, make("span", { class: "text" }, one ? one.shown[0] : "–"), one ? make("span", { class: "below" }, one.shown[1]) : null, one ? badge(one.status) : null);
    });
    return make("tr", null, make("th", { scope: "row", "data-title": "flight" }, make("span", { class: "text" }, flight.name)), make("td", { "data-title": "verdict" }, badge(flight.report.verdict.status)), ...cells);
  });
  const head = make("tr", null, make("th", { scope: "col" }, "flight"), make("th", { scope: "col" }, "verdict"), ...titles.map((one) => make("th", { scope: "col" }, one)));
  const table = make("div", { class: "table" }, make("table", null, make("thead", null, head), make("tbody", null, ...rows)));
  const plots = names.map(([name, one]) => {
    const title = `${one.words} ${one.symbol}${one.unit ? ` [${one.unit}]` : ""}`;
    const beside = several.filter((flight) => reported(flight, name)).map((flight) => ({ label: flight.name, whole: flight.logs.length > 1, ...reported(flight, name) }));
    return make("figure", null, make("h3", { class: "title" }, `${title[0].toUpperCase()}${title.slice(1)}`), forestOf(title, beside.sort((a, b) => a.whole - b.whole)));
  });
  const words = make("p", { class: "words" }, "Lines are 95 % intervals; arrows go on beyond the scale. Full dots are identified, hollow ones weak, squares provisional, crosses refused; a diamond is a pool.");
  const nothing = [make("p", null, "None of these flights has a number to compare.")];
  found("compared").replaceChildren(...(names.length ? [table, make("div", { class: "plots" }, ...plots), words] : nothing));
}

function pooled() {
  const single = flights.filter((one) => one.report && one.logs.length === 1);
  const pool = flightOf(`${single.length} flights pooled`, single.flatMap((one) => one.logs));
  pool.asked = single.map(({ logs, options }) => ({ log: logs[0], window: windowWords(options) }));
  queued(pool, { ...single[0].options, window: null });
}

// -- a forest, as reports draw theirs ----------------------------------------------------------------------
function forestOf(title, rows) {
  const height = FOREST.row * rows.length + FOREST.foot;
  const [low, high] = rangeOf(rows);
  const share = (value) => Math.min(Math.max((value - low) / (high - low), 0), 1);
  const across = (value) => FOREST.side + (FOREST.width - 2 * FOREST.side) * share(value);
  const top = FOREST.row * rows.length + 4;
  const content = rows.flatMap((row, place) => rowOf(row, FOREST.row * place, { low, high, across }));
  return draw("svg", { viewBox: `0 0 ${FOREST.width} ${height}`, class: "plot forest", role: "img", "aria-label": `${title}: ${rows.map((row) => `${row.label} ${row.shown.join(" ")}`).join("; ")}` }, ...axisOf(low, high, across, top), draw("text", { x: FOREST.width / 2, y: top + 35, class: "axis middle" }, title), ...content);
}

// The scale is made for intervals that are not far wider than the middle one; what goes on beyond it is an arrow.
function rangeOf(rows) {
  const whole = rows.filter(({ interval }) => interval[0] !== null && interval[1] !== null);
  const halves = whole.map(({ interval }) => (interval[1] - interval[0]) / 2).sort((a, b) => a - b);
  const middle = halves[Math.floor((halves.length - 1) / 2)] || 0;
  const reported = whole.filter(({ interval }) => (interval[1] - interval[0]) / 2 <= 6 * middle).flatMap(({ interval, at }) => [...interval, at]);
  const ends = reported.length ? reported : rows.map(({ at }) => at ?? 0);
  const [low, high] = [Math.min(...ends), Math.max(...ends)];
  const margin = 0.06 * (high - low) || 0.1 * Math.abs(high) || 0.1;
  return [low - margin, high + margin];
}

// Round values, with a power of ten where they are tiny or huge.
function ticksOf(low, high) {
  const raw = (high - low) / 4;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 2.5, 5, 10].map((one) => one * power).find((one) => one >= raw * (1 - 1e-9));
  const [first, last] = [Math.ceil(low / step - 1e-9), Math.floor(high / step + 1e-9)];
  const values = Array.from({ length: last - first + 1 }, (_, place) => (first + place) * step);
  const largest = Math.max(...values.map(Math.abs));
  const exponent = !largest || (largest >= 1e-3 && largest < 1e6) ? 0 : Math.floor(Math.log10(largest));
  const apart = step / 10 ** exponent;
  const decimals = [...Array(12).keys()].find((one) => Math.abs(Number(apart.toFixed(one)) - apart) < 1e-9 * apart) ?? 11;
  return values.map((at) => [at, `${(at / 10 ** exponent + 0).toFixed(decimals)}${exponent && at ? `e${exponent}` : ""}`.replaceAll("-", "−")]);
}

// What stands at the ticks, where there is room for it.
function axisOf(low, high, across, top) {
  let free = 0;
  return ticksOf(low, high).flatMap(([value, words]) => {
    const at = across(value);
    const half = 4 * words.length;
    const line = draw("line", { x1: at, x2: at, y1: 0, y2: top, class: "grid" });
    if (at - half < free || at + half > FOREST.width) return [line];
    free = at + half + 8;
    return [line, draw("text", { x: at, y: top + 16, class: "tick middle" }, words)];
  });
}

function rowOf(row, top, { low, high, across }) {
  const numbers = [...new Set(row.shown)].join(" ");
  const room = Math.floor((FOREST.width - 2 * FOREST.side) / FOREST.letter - numbers.length - 2);
  const look = row.whole ? "whole" : row.status;
  const y = top + 30;
  const pieces = [draw("text", { x: FOREST.side, y: top + 15, class: "row" }, cut(row.label, Math.max(room, 2))), draw("text", { x: FOREST.width - FOREST.side, y: top + 15, class: "row end numbers" }, numbers)];
  const mark = draw("g", { class: look });
  if (row.at !== null) {
    const [from, to] = [row.interval[0] ?? -Infinity, row.interval[1] ?? Infinity];
    mark.append(draw("line", { x1: across(from), x2: across(to), y1: y, y2: y, class: `whisker ${look}` }));
    for (const [at, beyond, turn] of [[across(from), from < low, -1], [across(to), to > high, 1]]) {
      const path = beyond ? `M${at - 6 * turn} ${y - 5}L${at} ${y}L${at - 6 * turn} ${y + 5}` : `M${at} ${y - 5}L${at} ${y + 5}`;
      mark.append(draw("path", { d: path, class: `whisker ${look}` }));
    }
    if (row.at >= low && row.at <= high) mark.append(pointOf(across(row.at), y, look));
  }
  return [...pieces, mark];
}

function pointOf(x, y, look) {
  const shapes = {
    whole: `M${x - 7} ${y}L${x} ${y - 6}L${x + 7} ${y}L${x} ${y + 6}Z`,
    provisional: `M${x - 4} ${y - 4}h8v8h-8Z`,
    refused: `M${x - 4} ${y - 4}l8 8M${x + 4} ${y - 4}l-8 8`,
  };
  if (shapes[look]) return draw("path", { d: shapes[look], class: `point ${look}` });
  return draw("circle", { cx: x, cy: y, r: 4.5, class: `point ${look}` });
}
