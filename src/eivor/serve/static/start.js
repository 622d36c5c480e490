// -- the theme, and where logs are dropped -----------------------------------------------------------------
const dark = matchMedia("(prefers-color-scheme: dark)");
const theme = found("theme");
function isDark() {
  return root.dataset.theme ? root.dataset.theme === "dark" : dark.matches;
}
function themed() {
  theme.textContent = isDark() ? "Light" : "Dark";
  theme.setAttribute("aria-label", isDark() ? "Show the page light" : "Show the page dark");
  for (const frame of document.querySelectorAll("iframe")) themedFrame(frame);
}
theme.addEventListener("click", () => {
  root.dataset.theme = isDark() ? "light" : "dark";
  themed();
});
dark.addEventListener("change", themed);
themed();

for (const name of ["files", "folder"]) {
  found(name).addEventListener("change", (event) => {
    dropped(filesOfInput(event.target.files));
    event.target.value = "";
  });
}
found("example").addEventListener("click", () => begun("example_flight.parquet", example));
for (const kind of ["dragenter", "dragover"]) {
  addEventListener(kind, (event) => {
    event.preventDefault();
    root.dataset.dragging = "";
  });
}
addEventListener("dragleave", (event) => {
  if (!event.relatedTarget) delete root.dataset.dragging;
});
addEventListener("drop", (event) => {
  event.preventDefault();
  delete root.dataset.dragging;
  filesOfDrop(event.dataTransfer).then(dropped);
});
found("compare").addEventListener("click", () => picking("compared"));
found("pool").addEventListener("click", pooled);
// A tab that is closed leaves nothing behind.
addEventListener("pagehide", (event) => {
  if (event.persisted) return;
  for (const { job, result } of flights) for (const one of new Set([job, result])) if (one) forgotten(`/jobs/${one}`);
  for (const log of new Set(flights.flatMap((one) => one.logs))) forgotten(`/logs/${log}`);
});

// What may be chosen, and which files of folders are logs.
const known = jsonOf("/choices")
  .then((reported) => {
    choices = { ...choices, ...reported };
    if (resulting) {
      resulting = null;
      arranged();
    }
  })
  .catch((error) => found("drop").after(failureOf(error)));
