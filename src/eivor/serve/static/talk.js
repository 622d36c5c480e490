// -- what goes between the page and its server -------------------------------------------------------------
class Refusal extends Error {
  constructor(error) {
    super(error.sentence || "The server refused it and did not say why.");
    this.advice = error.advice && !this.message.includes(error.advice) ? error.advice : "";
  }
}
const GONE = { sentence: "Eivor's server does not answer.", advice: "Start it again with `eivor serve` and open the address that it prints." };
const UNREADABLE = { sentence: "The browser cannot read this file.", advice: "Look whether it is still there, and may be read." };
const NO_LOG = { sentence: "No log is in this folder." };
const TOO_MANY = { sentence: "A hundred logs are the most that are taken at once.", advice: "Of many logs, `eivor fleet run` makes one table." };
const STOPPED = { sentence: "The server stopped before it had finished this.", advice: "Try again; where it happens again, take a shorter window." };

// The token is in the address, where loading the page again finds it.
const TOKEN = new URLSearchParams(location.search).get("token") ?? "";

async function ask(method, path, { body, headers, keepalive } = {}) {
  let answer;
  try {
    answer = await fetch(path, { method, body, keepalive, headers: { "X-Eivor-Token": TOKEN, ...headers }, cache: "no-store", redirect: "error" });
  } catch {
    throw new Refusal(GONE);
  }
  if (answer.ok) return answer;
  const reported = await answer.json().catch(() => ({}));
  throw new Refusal(reported.error || { sentence: `The server answered ${answer.status}.` });
}

async function received(read) {
  try {
    return await read();
  } catch (error) {
    throw error instanceof Refusal ? error : new Refusal(GONE);
  }
}
const jsonOf = (path) => received(async () => (await ask("GET", path)).json());
const textOf = (path) => received(async () => (await ask("GET", path)).text());
const posted = (path, value) => received(async () => (await ask("POST", path, { body: JSON.stringify(value), headers: { "Content-Type": "application/json" } })).json());

// Letters of a header that the server takes.
const LONGEST_HEADER = 60000;
const encoded = (name) => encodeURIComponent(name.toWellFormed());

async function sent({ name, files, isFolder, advice }) {
  if (!files.length) throw new Refusal({ ...NO_LOG, advice });
  for (const file of files) {
    await file.slice(0, 1).arrayBuffer().catch(() => {
      throw new Refusal(UNREADABLE);
    });
  }
  const body = isFolder ? new Blob(files) : files[0];
  if (body.size > (choices.largest_bytes ?? Infinity)) {
    const most = `${Math.round(choices.largest_bytes / 1e6)} MB`;
    throw new Refusal({ sentence: `This log has ${Math.round(body.size / 1e6)} MB; ${most} is the most that is taken.`, advice: "Cut the log to the manoeuvre, or use `eivor identify`." });
  }
  const headers = { "X-Eivor-Name": encoded(name), "Content-Type": "application/octet-stream" };
  if (isFolder) {
    headers["X-Eivor-Files"] = files.map((file) => `${encoded(file.name)}/${file.size}`).join(" ");
    if (files.length > choices.folders.most || headers["X-Eivor-Files"].length > LONGEST_HEADER) {
      throw new Refusal({ sentence: `This folder has ${files.length} files; ${choices.folders.most} are the most that are taken.`, advice: "Use `eivor identify`." });
    }
  }
  return received(async () => (await ask("POST", "/logs", { body, headers })).json());
}
const example = () => posted("/example", {});
const forgotten = (path) => ask("DELETE", path, { keepalive: true }).catch(() => null);

// Lines of JSON as they come.
async function* events(path) {
  const answer = await ask("GET", path);
  const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const { value, done } = await received(() => reader.read());
    rest += value || "";
    const lines = rest.split("\n");
    rest = lines.pop();
    for (const line of lines) if (line.trim()) yield JSON.parse(line);
    if (done) return;
  }
}

// A file out of the server onto the disk.
async function saved(path, fallback) {
  const answer = await ask("GET", path);
  const name = /filename="([^"]+)"/.exec(answer.headers.get("Content-Disposition") || "")?.[1] || fallback;
  const address = URL.createObjectURL(await received(() => answer.blob()));
  make("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 1000);
}
