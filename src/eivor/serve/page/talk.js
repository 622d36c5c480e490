// -- what goes between the page and its server -------------------------------------------------------------
class Refusal extends Error {
  constructor(error) {
    super(error.sentence || "The server refused it and did not say why.");
    this.advice = error.advice && !this.message.includes(error.advice) ? error.advice : "";
  }
}
const GONE = { sentence: "Eivor's server does not answer.", advice: "Start it again with `eivor serve` and open the address that it prints." };
const UNREADABLE = { sentence: "The browser cannot read this file.", advice: "Drop a log itself, not its folder." };
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
  const told = await answer.json().catch(() => ({}));
  throw new Refusal(told.error || { sentence: `The server answered ${answer.status}.` });
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
async function sent(file) {
  await file.slice(0, 1).arrayBuffer().catch(() => {
    throw new Refusal(UNREADABLE);
  });
  if (file.size > (choices.largest_bytes ?? Infinity)) {
    const most = `${Math.round(choices.largest_bytes / 1e6)} MB`;
    throw new Refusal({ sentence: `This file has ${Math.round(file.size / 1e6)} MB; ${most} is the most that is taken.`, advice: "Cut the log to the manoeuvre, or use `eivor identify`." });
  }
  const headers = { "X-Eivor-Name": encodeURIComponent(file.name.toWellFormed()), "Content-Type": "application/octet-stream" };
  return received(async () => (await ask("POST", "/logs", { body: file, headers })).json());
}
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
