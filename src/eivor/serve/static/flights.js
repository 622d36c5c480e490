// -- flights: what was dropped, how far it is, what came of it ---------------------------------------------
const STAGES = ["waiting", "reading", "preparing", "identifying", "diagnosing", "writing"];
// Streams of progress that a tab keeps open: browsers give a server six connections, for all tabs together.
const AT_ONCE = 2;
const flights = [];
const queue = [];
let running = 0;
let chosen = null;
let picked = false;

function flightOf(name, logs) {
  const flight = { name: named(name), logs, state: "sending", options: {}, course: null, report: null, error: null, job: null, cancelled: false };
  flight.card = cardOf(flight);
  flights.push(flight);
  found("cards").append(flight.card.whole);
  shown(found("flights"), true);
  root.dataset.begun = "";
  return flight;
}

function cardOf(flight) {
  const stages = STAGES.map((word) => make("li", null, shape("ahead"), make("span", null, word), make("span", { class: "now" })));
  const card = {
    state: make("p", { class: "state" }),
    stages: make("ol", { class: "stages", hidden: true, "aria-label": `Stages of ${flight.name}` }, ...stages),
    show: button(make("span", { class: "flight-name" }, flight.name), () => picking(flight), { class: "show" }),
    cancel: button("Cancel", () => cancelled(flight), { "aria-label": `Cancel ${flight.name}` }),
    remove: button("Remove", () => removed(flight), { "aria-label": `Remove ${flight.name}` }),
  };
  const doing = make("div", { class: "doing" }, card.cancel, card.remove);
  card.whole = make("li", { class: "card" }, make("div", { class: "row-of-card" }, make("div", null, card.show, card.state), doing), card.stages);
  return card;
}

// -- from a file to a result -------------------------------------------------------------------------------
async function dropped(found) {
  if (found.length > 1 || found[0]?.[0]) await known;
  if (!found.length) return;
  const logs = logsAmong(found);
  for (const log of logs.slice(0, MOST_LOGS)) begun(log.name, () => sent(log));
  if (logs.length > MOST_LOGS) begun(`${logs.length - MOST_LOGS} logs more`, () => Promise.reject(new Refusal(TOO_MANY)));
}

// A flight that waits for its turn to be sent.
function begun(name, sending) {
  const flight = flightOf(name, []);
  if (flights.length === 1) chosen = flight;
  flight.begin = async () => {
    flight.logs = [(await sending()).log];
  };
  queued(flight, {});
}

function queued(flight, options) {
  Object.assign(flight, { state: "waiting", options, error: null, cancelled: false, job: null, stage: "waiting", elapsed: 0, position: null });
  queue.push(flight);
  reported(flight);
  next();
}

function next() {
  while (running < AT_ONCE && queue.length) {
    running += 1;
    fitted(queue.shift()).finally(() => {
      running -= 1;
      next();
    });
  }
}

async function fitted(flight) {
  try {
    if (flight.begin && !flight.logs.length) {
      flight.state = "sending";
      reported(flight);
      await flight.begin();
    }
    if (!flight.cancelled) await worked(flight);
  } catch (error) {
    flight.state = "failed";
    flight.error = error instanceof Refusal ? error : new Refusal({ sentence: `This page failed: ${error.message}.`, advice: "Load it again." });
  }
  if (flight.cancelled) flight.state = "cancelled";
  finished(flight);
}

const windowWords = ({ window }) => window?.join(":") ?? "";

async function worked(flight) {
  const options = { ...flight.options, window: windowWords(flight.options) };
  flight.job = (await posted("/jobs", { logs: flight.asked || flight.logs, options })).job;
  flight.state = "working";
  if (flight.cancelled) await forgotten(`/jobs/${flight.job}`);
  let last = {};
  for await (const event of events(`/jobs/${flight.job}/events`)) {
    last = event;
    if (event.stage) {
      Object.assign(flight, { stage: event.stage, elapsed: event.elapsed ?? flight.elapsed, position: event.position ?? null });
      reported(flight);
    }
  }
  if (last.failed) throw new Refusal(last.failed);
  if (last.cancelled) flight.cancelled = true;
  else if (!last.done) throw new Refusal(STOPPED);
  else {
    flight.report = reportOf(await textOf(`/jobs/${flight.job}/report.html`));
    if (flight.result) forgotten(`/jobs/${flight.result}`);
    flight.result = flight.job;
    flight.course ||= flight.logs.length === 1 ? courseOf(flight.report) : null;
    flight.state = "done";
  }
}

function finished(flight) {
  if (!flights.includes(flight)) return forgottenWhole(flight);
  reported(flight);
  const status = flight.report?.verdict.status;
  announce(`${flight.name}: ${flight.state === "done" ? SHOWN[status] || status : WORDS[flight.state]}`);
  const done = flights.filter((one) => one.report);
  if (!picked && done.length > 1) chosen = "compared";
  else if (!chosen || (!picked && chosen.state === "failed" && flight.state === "done")) chosen = flight;
  arranged();
}

function cancelled(flight) {
  flight.cancelled = true;
  const place = queue.indexOf(flight);
  if (place >= 0) {
    queue.splice(place, 1);
    flight.state = "cancelled";
    finished(flight);
  } else if (flight.job) forgotten(`/jobs/${flight.job}`);
}

function removed(flight) {
  const place = flights.indexOf(flight);
  if (["waiting", "working", "sending"].includes(flight.state)) cancelled(flight);
  flights.splice(place, 1);
  flight.card.whole.remove();
  forgottenWhole(flight);
  if (chosen === flight || (chosen === "compared" && flights.filter((one) => one.report).length < 2)) chosen = flights.find((one) => one.report) || flights[0] || null;
  if (!flights.length) delete root.dataset.begun;
  shown(found("flights"), flights.length > 0);
  (flights[Math.min(place, flights.length - 1)]?.card.show || found("files")).focus();
  arranged();
}

// A result, and logs that no other flight here is of.
function forgottenWhole(flight) {
  if (flight.result) forgotten(`/jobs/${flight.result}`);
  const shared = (log) => flights.some((one) => one.logs.includes(log));
  for (const log of flight.logs) if (!shared(log)) forgotten(`/logs/${log}`);
}

function picking(flight) {
  chosen = flight;
  picked = true;
  arranged();
}

// -- what a card says --------------------------------------------------------------------------------------
const WORDS = { sending: "on its way to the server on this machine", waiting: "waiting for its turn", cancelled: "cancelled", failed: "no result" };

function reported(flight) {
  const { card } = flight;
  const working = flight.state === "working";
  const busy = working || flight.state === "waiting" || flight.state === "sending";
  shown(card.stages, working);
  shown(card.cancel, busy);
  card.whole.dataset.state = flight.state;
  if (working) staged(flight);
  let words = [WORDS[flight.state] || ""];
  if (flight.state === "done") words = [badge(flight.report.verdict.status), ` after ${seconds(flight.elapsed)}`];
  else if (working) words = [flight.stage === "waiting" && flight.position ? `waiting, ${flight.position} before it` : `${flight.stage}, ${seconds(flight.elapsed)}`];
  else if (flight.state === "failed") words = [badge("refused", "no result"), make("span", { class: "why" }, said(`${flight.error.message} ${flight.error.advice}`))];
  card.state.replaceChildren(...words);
}

function staged(flight) {
  const at = STAGES.indexOf(flight.stage);
  [...flight.card.stages.children].forEach((item, place) => {
    const look = place < at ? "over" : place === at ? "now" : "ahead";
    if (item.dataset.look !== look) item.firstChild.replaceWith(shape(look));
    item.dataset.look = look;
    if (place === at) item.setAttribute("aria-current", "step");
    else item.removeAttribute("aria-current");
    item.lastChild.textContent = look === "now" ? " now" : "";
  });
}

// -- what is shown below the cards -------------------------------------------------------------------------
function arranged() {
  for (const flight of flights) {
    if (flight === chosen) flight.card.show.setAttribute("aria-current", "true");
    else flight.card.show.removeAttribute("aria-current");
  }
  const several = flights.filter((one) => one.report);
  shown(found("together"), several.length > 1);
  found("compare").setAttribute("aria-pressed", String(chosen === "compared"));
  found("pool").disabled = several.filter((one) => one.logs.length === 1).length < 2;
  shown(found("comparison"), chosen === "compared");
  if (chosen === "compared") comparisonOf(several);
  const one = chosen && chosen !== "compared" && (chosen.report || chosen.error || chosen.state === "cancelled") ? chosen : null;
  shown(found("result"), one !== null);
  if (one) resultOf(one);
}
