// -- the course of a flight, and the window of it that is fitted -------------------------------------------
const MISSING = 65535;
const COURSE = { width: 1000, height: 100 };

// Height over time where a report draws it, else the last of its charts, which is the input.
function courseOf(report) {
  const charts = Object.values(report.charts).filter((chart) => chart.group === "flight-1");
  const chart = charts.find((one) => one.unit === "m") || charts.at(-1);
  if (!chart) return null;
  const { low, step, codes } = chart.lines[0];
  const bytes = Uint8Array.from(atob(codes), (letter) => letter.charCodeAt(0));
  const values = Array.from(new Uint16Array(bytes.buffer), (code) => (code === MISSING ? null : low + code * step));
  const points = [];
  let first = 0;
  for (const [start, apart, count] of chart.stretches) {
    for (let place = 0; place < count; place += 1) points.push([start + apart * place, values[first + place]]);
    points.push([start + apart * count, null]);
    first += count;
  }
  return { title: chart.title, over: chart.over, points };
}

function courseDrawn({ over, points }) {
  const levels = points.map(([, level]) => level).filter((level) => level !== null);
  const [low, high] = [levels.reduce((a, b) => Math.min(a, b), Infinity), levels.reduce((a, b) => Math.max(a, b), -Infinity)];
  const across = (time) => (COURSE.width * (time - over[0])) / (over[1] - over[0]);
  const up = (level) => COURSE.height - 6 - ((COURSE.height - 12) * (level - low)) / (high - low || 1);
  let path = "";
  let begun = false;
  for (const [time, level] of points) {
    if (level !== null) path += `${begun ? "L" : "M"}${across(time).toFixed(1)} ${up(level).toFixed(1)}`;
    begun = level !== null;
  }
  return draw(
    "svg",
    { viewBox: `0 0 ${COURSE.width} ${COURSE.height}`, preserveAspectRatio: "none", class: "course", "aria-hidden": "true" },
    draw("rect", { class: "chosen", y: 0, height: COURSE.height }),
    draw("path", { d: path, class: "curve measured", "vector-effect": "non-scaling-stroke" }),
  );
}

// Two handles over the course; `value()` is null for the whole flight.
function windowOf(flight, changed) {
  const { over, title } = flight.course;
  const [low, high] = [Math.floor(over[0] * 10) / 10, Math.ceil(over[1] * 10) / 10];
  const least = Math.min(1, (high - low) / 4);
  const given = flight.options.window || over;
  const handle = (words, value) => make("input", { type: "range", min: low, max: high, step: 0.1, value, "aria-label": words });
  const ends = [handle("The window begins at", given[0] <= over[0] ? low : given[0]), handle("The window ends at", given[1] >= over[1] ? high : given[1])];
  const drawn = courseDrawn(flight.course);
  const words = make("output");
  const whole = button("Whole flight", () => moved([low, high]), { class: "quiet" });
  const at = () => ends.map((one) => Number(one.value));
  const isWhole = () => at()[0] <= low && at()[1] >= high;

  function moved([from, to]) {
    ends[0].value = from;
    ends[1].value = to;
    looked();
  }
  function looked() {
    const [from, to] = at();
    const share = (time) => (COURSE.width * (time - low)) / (high - low);
    drawn.firstChild.setAttribute("x", share(from));
    drawn.firstChild.setAttribute("width", Math.max(share(to) - share(from), 0));
    ends.forEach((one) => one.setAttribute("aria-valuetext", seconds(Number(one.value))));
    words.textContent = isWhole() ? `${seconds(from)} to ${seconds(to)}, the whole flight` : `${seconds(from)} to ${seconds(to)}`;
    whole.disabled = isWhole();
    changed();
  }
  ends[0].addEventListener("input", () => moved([Math.min(at()[0], at()[1] - least), at()[1]]));
  ends[1].addEventListener("input", () => moved([at()[0], Math.max(at()[1], at()[0] + least)]));
  drawn.addEventListener("pointerdown", (event) => {
    const box = drawn.getBoundingClientRect();
    const time = Math.round((low + ((high - low) * (event.clientX - box.left)) / box.width) * 10) / 10;
    const [from, to] = at();
    const first = Math.abs(time - from) < Math.abs(time - to);
    moved(first ? [Math.min(time, to - least), to] : [from, Math.max(time, from + least)]);
    ends[first ? 0 : 1].focus();
    event.preventDefault();
  });
  const value = () => (isWhole() ? null : [at()[0] <= low ? over[0] : at()[0], at()[1] >= high ? over[1] : at()[1]]);
  const slider = make("div", { class: "slider" }, drawn, ...ends);
  const box = make("div", { class: "window", role: "group", "aria-label": `Window of the flight, over its ${title}` }, make("p", { class: "label" }, "Window ", make("span", { class: "soft" }, `over: ${title}`)), slider, make("p", { class: "ends" }, words, whole));
  return { box, value, looked };
}
