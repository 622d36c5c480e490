// -- what may be chosen before a flight is fitted again ----------------------------------------------------
let choices = { models: [], methods: [], maps: [], vehicles: [], targets: [], plans: [] };
const OWN_FILE = "own file";
let fields = 0;

function field(words, input, hint, file = null) {
  fields += 1;
  const name = `field-${fields}`;
  input.id = name;
  if (hint) input.setAttribute("aria-describedby", `${name}-hint`);
  return make("div", { class: "field" }, make("label", { for: name }, words), input, file, hint ? make("p", { class: "hint", id: `${name}-hint` }, hint) : null);
}

const text = (placeholder, value = "") => make("input", { type: "text", placeholder, value, autocomplete: "off", spellcheck: "false" });

function listOf(entries, given, none) {
  const options = entries.map((one) => make("option", { value: one.name, selected: one.name === given }, one.words && one.words !== one.name ? `${one.name}: ${one.words}` : one.name));
  return make("select", null, none === null ? null : make("option", { value: "" }, none), ...options);
}

// One out of a list, or the text of a file; `value()` is what the server takes.
function listOrFile(entries, given, none, kinds, changed = () => {}) {
  const known = !given || entries.some((one) => one.name === given);
  let text = known ? "" : given;
  const list = listOf(entries, known ? given : "", none);
  list.append(make("option", { value: OWN_FILE, selected: !known }, "a file of mine"));
  const file = make("input", { type: "file", accept: kinds, "aria-label": "The file", hidden: known });
  list.addEventListener("change", () => {
    file.hidden = list.value !== OWN_FILE;
    if (file.hidden || text) changed();
  });
  file.addEventListener("change", async () => {
    text = (await file.files[0]?.text()) || "";
    changed();
  });
  return { list, file, value: () => (list.value === OWN_FILE ? text : list.value) };
}

function choicesOf(flight) {
  const given = flight.options;
  const inputs = {
    model: listOf(choices.models, given.model, "all that the log supports"),
    method: listOf(choices.methods, given.method, "the recipe's own"),
    lag: text("70:15", given.lag),
    input_channel: text("rotor_command", given.input_channel),
    input_map: text("fit", given.input_map),
  };
  const compare = make("input", { type: "checkbox", checked: Boolean(given.compare) });
  const vehicle = listOrFile(choices.vehicles, given.vehicle, "none", ".toml");
  const map = listOrFile(choices.maps, given.map, "none, or as the log says", ".toml");
  const asked = () => {
    const words = Object.entries(inputs).map(([name, input]) => [name, input.value.trim()]);
    const every = [...words, ["vehicle", vehicle.value()], ["map", map.value()], ["compare", compare.checked], ["window", course?.value() || null]];
    return Object.fromEntries(every.filter(([, value]) => value));
  };
  const again = button("Fit again", () => {
    picked = true;
    chosen = flight;
    queued(flight, asked());
    flight.card.whole.scrollIntoView({ block: "nearest" });
    flight.card.cancel.focus();
  }, { class: "main" });
  const course = flight.course ? windowOf(flight, () => {}) : null;
  const form = make(
    "div",
    { class: "fields" },
    field("Model", inputs.model),
    field("Method", inputs.method),
    field("Lag known from elsewhere [ms]", inputs.lag, "70:15 is 70 ± 15 ms, 50..90 is anything between, none is neither lag nor delay"),
    field("Input", inputs.input_channel, "what drives the vehicle: input is the thrust setpoint, rotor_command the signals to the motors"),
    field("Input map", inputs.input_map, "from command to thrust: linear, square, power:EXPONENT, mixed:SHARE; fit finds it out"),
    field("Vehicle", vehicle.list, "for the rigid body", vehicle.file),
    field("Channel map", map.list, "for tables, bags and a Crazyflie's log", map.file),
    field("Every method side by side", compare, "takes longer"),
  );
  const more = make("details", { open: !flight.report || Object.keys(given).some((name) => name !== "window") }, make("summary", null, "Model, method, lag and more"), form);
  const box = make("section", { class: "panel", "aria-label": "Fit again" }, course?.box, more, make("p", { class: "actions" }, again));
  course?.looked();
  return box;
}
