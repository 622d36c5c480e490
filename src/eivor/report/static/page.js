// The page of a result: charts over time that zoom together, the theme, saving. Text goes in as text only.
"use strict";
(() => {
  const root = document.documentElement;
  const parsed = (name) => JSON.parse(document.getElementById(name).textContent);
  const MISSING = 65535;
  const LOOKS = {
    measured: { colour: "--measured", width: 1.2, dash: [] },
    predicted: { colour: "--predicted", width: 1.4, dash: [7, 3] },
    residual: { colour: "--residual", width: 1, dash: [] },
    edge: { colour: "--hatch", width: 0.8, dash: [] },
  };
  const colour = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const charts = new Map();

  // -- data ------------------------------------------------------------------------------------------------
  function decoded(line) {
    const bytes = Uint8Array.from(atob(line.codes), (letter) => letter.charCodeAt(0));
    const codes = new Uint16Array(bytes.buffer);
    return Array.from(codes, (code) => (code === MISSING ? null : line.low + code * line.step));
  }

  // One array of times and one for each line, with nothing between stretches that do not touch.
  function joined(chart) {
    const columns = [[], ...chart.lines.map(() => [])];
    const values = chart.lines.map(decoded);
    let first = 0;
    for (const [start, step, count] of chart.stretches) {
      for (let place = 0; place < count; place += 1) {
        columns[0].push(start + step * place);
        values.forEach((one, line) => columns[line + 1].push(one[first + place]));
      }
      columns[0].push(start + step * (count - 0.5));
      values.forEach((_, line) => columns[line + 1].push(null));
      first += count;
    }
    return columns;
  }

  // A chart over frequency has decadic logarithms along x.
  const named = (x, chart, digits) => (chart.hertz ? `${+(10 ** x).toPrecision(3)} Hz` : `${+x.toFixed(digits)} s`);
  function frequencies(_, __, low, high) {
    const ticks = [];
    for (let decade = Math.floor(low); decade <= high; decade += 1) {
      for (const digit of [1, 2, 5]) ticks.push(decade + Math.log10(digit));
    }
    return ticks.filter((tick) => tick >= low && tick <= high);
  }

  // -- drawing ---------------------------------------------------------------------------------------------
  function hatched(chart) {
    return (plot) => {
      const { ctx, bbox } = plot;
      ctx.save();
      ctx.beginPath();
      ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
      ctx.clip();
      ctx.strokeStyle = colour("--hatch");
      ctx.lineWidth = devicePixelRatio;
      for (const [from, to] of chart.leftOut) {
        const left = Math.max(plot.valToPos(from, "x", true), bbox.left);
        const right = Math.min(plot.valToPos(to, "x", true), bbox.left + bbox.width);
        if (right <= left) continue;
        ctx.save();
        ctx.beginPath();
        ctx.rect(left, bbox.top, Math.max(right - left, devicePixelRatio), bbox.height);
        ctx.clip();
        ctx.beginPath();
        const gap = 9 * devicePixelRatio;
        for (let x = bbox.left - bbox.height; x < bbox.left + bbox.width; x += gap) {
          ctx.moveTo(x, bbox.top + bbox.height);
          ctx.lineTo(x + bbox.height, bbox.top);
        }
        ctx.stroke();
        ctx.restore();
      }
      ctx.restore();
    };
  }

  function options(box, chart) {
    const font = `12px ${getComputedStyle(document.body).fontFamily}`;
    const axis = { stroke: () => colour("--soft"), font, grid: { stroke: () => colour("--faint"), width: 1 }, ticks: { show: false } };
    return {
      width: Math.max(box.clientWidth, 50),
      height: Math.max(box.clientHeight, 50),
      legend: { show: false },
      cursor: { sync: { key: chart.group, scales: ["x", null] }, drag: { x: true, y: false }, points: { size: 6 } },
      scales: { x: { time: false, range: (_, low, high) => [low, high] } },
      axes: [
        { ...axis, values: (_, ticks) => ticks.map((tick) => named(tick, chart, 6)), size: 30, space: 64, ...(chart.hertz ? { splits: frequencies } : {}) },
        { ...axis, size: 58, space: 34 },
      ],
      series: [
        {},
        ...chart.lines.map((line) => {
          const look = LOOKS[line.look];
          return { stroke: () => colour(look.colour), width: look.width, dash: look.dash, points: { show: false } };
        }),
      ],
      bands: chart.lines.flatMap(({ look }, line, all) =>
        look === "edge" && all[line + 1]?.look === "edge" ? [{ series: [line + 2, line + 1], fill: () => colour("--faint") }] : [],
      ),
      hooks: { drawClear: [hatched(chart)], setScale: [followed(chart)], setCursor: [reported(box, chart)] },
    };
  }

  // What stands under the cursor, in the legend.
  function reported(box, chart) {
    const places = box.parentElement.querySelectorAll(".at-cursor");
    return (plot) => {
      chart.lines.forEach((_, line) => {
        const value = plot.cursor.idx === null || plot.cursor.idx === undefined ? null : plot.data[line + 1][plot.cursor.idx];
        places[line].textContent = value === null ? "" : `${Number(value.toPrecision(4))} ${chart.unit}`;
      });
    };
  }

  // -- zoom ------------------------------------------------------------------------------------------------
  let following = false;
  function followed(chart) {
    return (plot, key) => {
      if (key !== "x" || following) return;
      const { min, max } = plot.scales.x;
      following = true;
      for (const other of charts.values()) {
        if (other.chart.group === chart.group && other.plot !== plot) other.plot.setScale("x", { min, max });
      }
      following = false;
      showWindow(chart, min, max);
    };
  }

  function showWindow(chart, min, max) {
    for (const tools of document.querySelectorAll(".charts")) {
      if (tools.dataset.group === chart.group) tools.querySelector(".shown").textContent = `${named(min, chart, 1)} to ${named(max, chart, 1)}`;
    }
  }

  const MOVES = {
    in: (low, high) => [low + 0.25 * (high - low), high - 0.25 * (high - low)],
    out: (low, high) => [low - 0.5 * (high - low), high + 0.5 * (high - low)],
    left: (low, high) => [low - 0.25 * (high - low), high - 0.25 * (high - low)],
    right: (low, high) => [low + 0.25 * (high - low), high + 0.25 * (high - low)],
  };
  const KEYS = { "+": "in", "=": "in", "-": "out", ArrowLeft: "left", ArrowRight: "right", 0: "whole" };

  function zoom({ plot, chart }, action) {
    let [low, high] = [plot.scales.x.min, plot.scales.x.max];
    const [first, last] = chart.over;
    if (action === "whole") [low, high] = chart.over;
    else if (action === "used") [low, high] = chart.view;
    else {
      [low, high] = MOVES[action](low, high);
      const wide = Math.min(high - low, last - first);
      low = Math.min(Math.max(low, first), last - wide);
      high = low + wide;
    }
    if (high - low > 0.02) plot.setScale("x", { min: low, max: high });
  }

  // -- making ----------------------------------------------------------------------------------------------
  function made(box, chart) {
    const plot = new uPlot(options(box, chart), joined(chart), box);
    charts.set(box.id, { plot, chart });
    plot.over.addEventListener("dblclick", () => zoom({ plot, chart }, "used"));
    box.addEventListener("keydown", (event) => {
      const action = KEYS[event.key];
      if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      zoom({ plot, chart }, action);
    });
    plot.setScale("x", { min: chart.view[0], max: chart.view[1] });
  }

  function fitted() {
    for (const [name, { plot }] of charts) {
      const box = document.getElementById(name);
      if (box.clientWidth > 0 && box.clientWidth !== plot.width) plot.setSize({ width: box.clientWidth, height: box.clientHeight });
    }
  }

  const redrawn = () => charts.forEach(({ plot }) => plot.redraw(false));

  for (const [name, chart] of Object.entries(parsed("charts"))) made(document.getElementById(name), chart);
  new ResizeObserver(fitted).observe(document.body);
  for (const tools of document.querySelectorAll(".charts")) {
    tools.addEventListener("click", (event) => {
      const button = event.target.closest("button[data-zoom]");
      const one = [...charts.values()].find(({ chart }) => chart.group === tools.dataset.group);
      if (button && one) zoom(one, button.dataset.zoom);
    });
  }

  // -- theme, paper, saving --------------------------------------------------------------------------------
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const theme = document.getElementById("theme");
  function isDark() {
    return root.dataset.theme ? root.dataset.theme === "dark" : dark.matches;
  }
  function themed() {
    theme.textContent = isDark() ? "Light" : "Dark";
    theme.setAttribute("aria-label", isDark() ? "Show the page light" : "Show the page dark");
    redrawn();
  }
  theme.addEventListener("click", () => {
    root.dataset.theme = isDark() ? "light" : "dark";
    themed();
  });
  dark.addEventListener("change", themed);
  themed();

  let before = null;
  addEventListener("beforeprint", () => {
    before = root.dataset.theme || "";
    root.dataset.theme = "light";
    fitted();
    redrawn();
  });
  addEventListener("afterprint", () => {
    if (before) root.dataset.theme = before;
    else delete root.dataset.theme;
    fitted();
    redrawn();
  });

  // -- within the page of `eivor serve`, which gives it its name --------------------------------------------
  if (window.name === "eivor-report" && parent !== window) {
    root.dataset.framed = "";
    const tellHeight = () => parent.postMessage({ height: document.body.offsetHeight }, "*");
    new ResizeObserver(tellHeight).observe(document.body);
    tellHeight();
    addEventListener("message", (event) => {
      if (event.source !== parent || !["light", "dark"].includes(event.data)) return;
      root.dataset.theme = event.data;
      themed();
    });
  }

  for (const one of document.querySelectorAll("[data-copied]")) {
    one.addEventListener("click", async () => {
      try {
        await navigator.clipboard.writeText(one.dataset.copied);
        one.textContent = "Copied";
      } catch {
        getSelection().selectAllChildren(one.previousElementSibling); // of a page without a clipboard
      }
    });
  }

  document.getElementById("save").addEventListener("click", () => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([document.getElementById("result").textContent], { type: "application/json" }));
    link.download = "eivor.json";
    link.click();
    URL.revokeObjectURL(link.href);
  });
})();
