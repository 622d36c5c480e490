// -- files to take along -----------------------------------------------------------------------------------
// What is in it is asked for when it is opened.
function downloadsOf(flight) {
  const job = `/jobs/${flight.result}`;
  const panel = make("div", { class: "panel" });
  const details = make("details", { class: "downloads" }, make("summary", null, "Downloads"), panel);
  details.addEventListener("toggle", () => {
    const whole = [["report.html", "this report, one page for any browser"], ["result.json", "all numbers"]];
    panel.append(filesOf(whole.map(([file, words]) => fileOf(file, words, () => `${job}/${file}`))), ...exportsOf(flight, job), ...plansOf(job));
  }, { once: true });
  return details;
}

const LONGEST_FILE = 64;
const filesOf = (rows) => make("ul", { class: "files" }, ...rows);

// Every target, with the reason where there is no file; asked again when a mass or a vehicle is given.
function exportsOf(flight, job) {
  const mass = text("1.53:0.02", flight.mass);
  const vehicle = listOrFile(choices.vehicles, flight.vehicle, "that of the result, if it has one", ".toml", () => listed());
  const list = filesOf([]);
  const priors = text("inertia_xx=0.025:0.003; torque_ratio=0.016", flight.priors);
  const query = () => queryOf([["mass", flight.mass], ["vehicle", flight.vehicle], ...flight.priors.split(";").map((one) => ["prior", one.trim()])]);
  async function listed() {
    [flight.mass, flight.vehicle, flight.priors] = [mass.value.trim(), vehicle.value(), priors.value.trim()];
    try {
      const { targets } = await jsonOf(`${job}/exports${query()}`);
      const readyFirst = [...targets].sort((one, other) => Boolean(one.reason) - Boolean(other.reason));
      list.replaceChildren(...readyFirst.map((one) => fileOf(one.file, one.words, () => `${job}/exports/${encodeURIComponent(one.name)}${query()}`, one)));
    } catch (error) {
      list.replaceChildren(make("li", { class: "failed" }, said(`${error.message} ${error.advice}`)));
    }
  }
  for (const one of [mass, priors]) one.addEventListener("change", listed);
  listed();
  const given = make("div", { class: "fields" }, field("Mass [kg]", mass, "with all on board, and its standard deviation"), field("Vehicle", vehicle.list, "where the rotors are, for simulators", vehicle.file), field("Known from elsewhere", priors, "what the flight does not tell, with semicolons between"));
  return [make("h3", { class: "flight" }, "For autopilots and simulators"), given, list];
}

function plansOf(job) {
  if (!choices.plans.length) return [];
  const wanted = listOf([{ name: "friction" }, { name: "gain" }, { name: "lag" }], "", "what this flight did not identify");
  const home = text("47.398,8.546");
  const query = () => queryOf([["for", wanted.value], ["home", home.value.trim()]]);
  const rows = choices.plans.map((one) => fileOf(one.file, one.words, () => `${job}/plan/${encodeURIComponent(one.name)}${query()}`));
  const given = make("div", { class: "fields" }, field("It should identify", wanted), field("Home", home, "latitude and longitude, which a plan of QGroundControl needs"));
  return [make("h3", { class: "flight" }, "Plan of the next flight"), make("p", { class: "hint" }, "It is flown in simulation before it is written, which takes a while."), given, filesOf(rows)];
}

function queryOf(reported) {
  const given = new URLSearchParams(reported.filter(([, value]) => value)).toString();
  return given ? `?${given}` : "";
}

// A row: what it is and a button, or the reason why there is none.
function fileOf(file, words, path, { reason = "", left_out: left = [] } = {}) {
  const without = left.length ? left.join(" ") : "";
  const note = make("span", { class: "why", role: "status" }, said(reason || without));
  const save = button(cut(visible(file), LONGEST_FILE), async () => {
    save.setAttribute("aria-busy", "true");
    note.textContent = "making it …";
    try {
      await saved(path(), file);
      note.textContent = "saved";
    } catch (error) {
      note.textContent = said(`${error.message} ${error.advice}`);
    }
    save.removeAttribute("aria-busy");
  }, { disabled: Boolean(reason), class: "file" });
  return make("li", { "data-refused": String(Boolean(reason)) }, save, make("span", { class: "what" }, words), note);
}
