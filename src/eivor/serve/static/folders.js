// -- which logs are among the files that were dropped or chosen --------------------------------------------
const MOST_FOUND = 5000;
const MOST_LOGS = 100;
const settled = (asked) => new Promise((resolve, reject) => asked(resolve, reject));

// Files as pairs: the folder that each lies in, and itself.
async function filesBelow(entry, folder, found) {
  if (found.length >= MOST_FOUND) return;
  if (entry.isFile) {
    found.push([folder, await settled((...both) => entry.file(...both))]);
    return;
  }
  const reader = entry.createReader();
  for (let some = [entry]; some.length; ) {
    some = await settled((...both) => reader.readEntries(...both));
    for (const one of some) await filesBelow(one, folder ? `${folder}/${entry.name}` : entry.name, found);
  }
}

// What a drop carries is there until the next turn only: it is taken before anything is awaited.
async function filesOfDrop(carried) {
  const entries = Array.from(carried.items, (item) => item.webkitGetAsEntry?.()).filter(Boolean);
  const files = Array.from(carried.files, (file) => ["", file]);
  if (!entries.some((one) => one.isDirectory)) return files;
  const found = [];
  for (const entry of entries) await filesBelow(entry, "", found).catch(() => null);
  return found.length ? found : [[entries[0].name, null]];
}
const filesOfInput = (files) => Array.from(files, (file) => [(file.webkitRelativePath || "").split("/").slice(0, -1).join("/"), file]);

// Name and files of each log: files of a folder that are one log together, and files one by one.
function logsAmong(found) {
  const folders = new Map();
  for (const [folder, file] of found) folders.set(folder, [...(folders.get(folder) || []), ...(file ? [file] : [])]);
  const logs = [...folders].flatMap(([folder, files]) => logsOf(folder, files));
  return logs.length ? logs : [{ name: [...folders.keys()][0] || "folder", files: [], advice: "Drop the logs themselves." }];
}

function logsOf(folder, files) {
  const { endings = [] } = choices.folders || {};
  const whole = wholeOf(folder.split("/").at(-1), files);
  if (whole) files = files.filter((one) => !whole.files.includes(one));
  else if (folder) files = files.filter(({ name }) => endings.some((end) => name.toLowerCase().endsWith(end)));
  const alone = files.map((file) => ({ name: file.name, files: [file] }));
  return whole ? [whole, ...(folder ? [] : alone)] : alone;
}

// The log that files are together, as of a bag of ROS 2 or of `ulog2csv`; a folder goes as it is.
function wholeOf(folder, files) {
  const { bags = [], metadata, tables, beside = [] } = choices.folders || {};
  const names = files.map((one) => one.name);
  const parts = names.filter((name) => bags.some((end) => name.endsWith(end)));
  const stems = new Set(parts.map((name) => name.replace(/(_\d+)?\.\w+(\.zstd)?$/, "")));
  const [stem] = stems;
  if (stems.size === 1 && (names.includes(metadata) || stem === folder)) return together(folder || stem, folder ? files : files.filter(({ name }) => name === metadata || parts.includes(name)));
  const table = new RegExp(`^${tables || "(?!)"}$`);
  const logs = new Set(names.map((name) => table.exec(name)?.[1]).filter((one) => one !== undefined));
  const [log] = logs;
  if (!logs.size || [...logs].some((one) => beside.some((end) => names.includes(one + end)))) return null;
  if (folder) return together(folder, files);
  const own = files.filter(({ name }) => table.exec(name)?.[1] === log);
  return logs.size === 1 && own.length > 1 ? together(log, own) : null;
}
const together = (name, files) => ({ name, files, isFolder: true });
