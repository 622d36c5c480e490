// -- the result of a flight --------------------------------------------------------------------------------
// A report holds what it holds as JSON, in scripts that hold no "<".
function reportOf(text) {
  const part = (name) => JSON.parse(new RegExp(`<script type="application/json" id="${name}">([^<]*)<\/script>`).exec(text)[1]);
  return { text, verdict: part("verdict"), charts: part("charts") };
}

let resulting = null;
function resultOf(flight) {
  const key = flight.report || flight.error || flight.state;
  if (resulting?.flight === flight && resulting.key === key) return;
  resulting = { flight, key };
  const heading = make("h2", { id: "result-heading" }, flight.name);
  const parts = [heading];
  if (flight.error) parts.push(failureOf(flight.error));
  else if (flight.state === "cancelled") parts.push(make("p", { class: "failure" }, "Cancelled. Fit it again below, or remove it above."));
  if (flight.report) parts.push(verdictOf(flight.report.verdict, Boolean(flight.error) || flight.state === "cancelled"));
  parts.push(choicesOf(flight));
  if (flight.report) parts.push(downloadsOf(flight), frameOf(flight.report));
  found("result").replaceChildren(...parts);
}

function failureOf(error) {
  return make("div", { class: "failure", role: "alert" }, make("p", null, badge("refused", "No result"), " ", said(error.message)), error.advice ? make("p", null, said(error.advice)) : null);
}

// The card, as the report draws it.
function verdictOf({ card }, earlier) {
  const pieces = [make("p", { class: "said" }, shape(card.look), make("strong", null, said(card.title)))];
  if (earlier) pieces.unshift(make("p", { class: "note" }, "The result before:"));
  for (const { look, heading, lines } of card.groups) {
    const numbers = lines.filter((line) => line.quantity).map(readingOf);
    const reasons = lines.filter((line) => !line.quantity).map((line) => make("li", null, said(`${line.words}: ${line.text}`), remarkOf("span", "remark", line.remark)));
    pieces.push(make("div", { class: "group" }, make("h3", null, badge(look, heading)), numbers.length ? make("div", { class: "readings" }, ...numbers) : null, reasons.length ? make("ul", null, ...reasons) : null));
  }
  pieces.push(make("p", { class: "note" }, "In brackets: 95 % intervals."));
  return make("div", { class: `verdict ${card.look}`, id: "verdict" }, ...pieces);
}

const remarkOf = (tag, look, text) => (text ? make(tag, { class: look }, said(text)) : null);
function readingOf(line) {
  const copied = (event) => navigator.clipboard.writeText(line.command).then(() => (event.target.textContent = "Copied"));
  const unit = line.unit ? make("span", { class: "unit" }, ` ${line.unit}`) : null;
  return make(
    "div",
    { class: "reading", "data-quantity": line.quantity },
    make("p", { class: "name" }, `${line.words} `, make("span", { class: "symbol" }, ...line.symbol.split(/_(\w+)/).map((piece, place) => (place % 2 ? make("sub", null, piece) : piece)))),
    make("p", { class: "number" }, make("span", { class: "value" }, line.text), unit),
    make("p", { class: "interval" }, line.interval),
    remarkOf("p", "setting", line.setting.replace("->", "→")),
    remarkOf("p", "remark", line.remark),
    line.command ? make("p", { class: "command" }, make("code", null, line.command), " ", button("Copy", copied)) : null,
  );
}

// The report itself, in a frame that has no origin and no more rights than its own script needs.
function frameOf(report) {
  const address = URL.createObjectURL(new Blob([report.text], { type: "text/html" }));
  const frame = make("iframe", { name: "eivor-report", title: "The report: why, what to fly next, checks and pictures", sandbox: "allow-scripts", src: address, class: "report" });
  frame.addEventListener("load", () => {
    URL.revokeObjectURL(address);
    themedFrame(frame);
  });
  return frame;
}

const themedFrame = (frame) => frame.contentWindow?.postMessage(isDark() ? "dark" : "light", "*");

addEventListener("message", (event) => {
  const frame = found("result").querySelector("iframe");
  const height = event.data?.height;
  if (!frame || event.source !== frame.contentWindow || !Number.isFinite(height)) return;
  frame.style.height = `${Math.min(Math.max(Math.ceil(height), 200), 60000)}px`;
});
