// The page: list of sessions, uploads, the example, and one session's view.

import { Problem, get, key, send, upload } from "./api.js";
import { SessionView } from "./session.js";

const $ = (id) => document.getElementById(id);
let view = null;
let next = null;

// What an error means to whoever looks at the page; the service's own words where they say more.
function words(error) {
  if (error instanceof TypeError) return "The service cannot be reached. Does it run?";
  if (error?.status === 401) return "This service wants an API key, or the one given is not in force.";
  if (error?.status === 404) return "There is no such session, or it belongs to another key.";
  return error?.message ?? error;
}

function notice(error, calm = false) {
  $("notice").textContent = words(error);
  $("notice").className = calm ? "calm" : "";
  $("notice").hidden = !error;
  if (error instanceof Problem && error.status === 401) askKey();
}

async function showList(older = false) {
  const page = await get(`/v1/sessions?limit=100${older && next ? `&before=${next}` : ""}`);
  next = page.next;
  const rows = page.sessions.map(row);
  if (older) $("sessions").append(...rows);
  else $("sessions").replaceChildren(...rows);
  $("empty").hidden = $("sessions").childElementCount > 0;
  $("more").hidden = !next;
}

function row(session) {
  const line = document.createElement("tr");
  const link = document.createElement("a");
  link.href = `#/s/${session.id}`;
  link.textContent = session.name || session.id.slice(0, 8);
  link.title = link.textContent;
  const remove = document.createElement("button");
  remove.textContent = "Delete";
  remove.onclick = async () => {
    if (!confirm(`Delete ${link.textContent} with all its measurements?`)) return;
    await send("DELETE", `/v1/sessions/${session.id}`).then(() => line.remove(), notice);
  };
  const changed = new Date(session.updated_at).toLocaleString();
  const integrity = document.createElement("span");
  integrity.textContent = session.integrity ?? "–";
  integrity.dataset.integrity = session.integrity ?? "";
  const what = `${session.method}, ${session.engine}`;
  for (const content of [link, what, String(session.next_epoch), integrity, changed, remove]) {
    const cell = document.createElement("td");
    cell.append(content);
    line.append(cell);
  }
  return line;
}

async function route() {
  notice(null);
  const match = location.hash.match(/^#\/s\/([0-9a-f]{32})(?:\/(hapslam-share_[0-9a-f]{12}_[\w-]{43}))?(?:\?with=([0-9a-f]{32}))?$/);
  if (match?.[2]) { // a link that was shared: its key goes where keys are, not into the history
    key.set(match[2]);
    history.replaceState(null, "", `#/s/${match[1]}`);
  }
  document.title = "hapslam";
  $("list").hidden = Boolean(match);
  $("session").hidden = !match;
  try {
    if (match) {
      view ??= new SessionView(notice);
      await view.open(match[1], match[3]);
    } else {
      view?.close();
      await showList();
    }
  } catch (error) {
    if (match) $("session").hidden = true;
    notice(error);
  }
}

// Sends the example as any client would, a few epochs at a time, so that the map grows.
async function runExample() {
  $("example").disabled = true;
  try {
    const shipped = await get(`/v1/example?seed=${Math.floor(1e6 * Math.random())}`);
    const session = await send("POST", "/v1/sessions", shipped.session);
    const path = `/v1/sessions/${session.id}`;
    await send("PUT", `${path}/truth`, shipped.truth);
    await send("POST", `${path}/sweeps`, shipped.sweep);
    location.hash = `#/s/${session.id}`;
    for (let i = 0; i < shipped.epochs.length; i += 3) {
      await send("POST", `${path}/epochs`, { epochs: shipped.epochs.slice(i, i + 3) });
    }
  } catch (error) {
    notice(error);
  } finally {
    $("example").disabled = false;
  }
}

async function take(file) {
  if (!file) return;
  const told = (share) => notice(share < 1 ? `Sending ${file.name}: ${Math.round(100 * share)} %` : `Taking in ${file.name} ...`, true);
  told(0);
  try {
    const session = await upload(`/v1/uploads?name=${encodeURIComponent(file.name.slice(0, 200))}`, file, told);
    location.hash = `#/s/${session.id}`;
  } catch (error) {
    notice(error);
  }
}

function askKey() {
  $("key-field").value = key.get();
  $("ask").showModal();
}

$("ask").addEventListener("close", () => {
  if ($("ask").returnValue !== "ok") return;
  key.set($("key-field").value.trim());
  route();
});
$("key").onclick = askKey;
$("more").onclick = () => showList(true).catch(notice);
$("example").onclick = runExample;
$("file").onchange = () => take($("file").files[0]);
for (const name of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault();
    $("drop").classList.toggle("over", name === "dragover");
    if (name === "drop") take(event.dataTransfer.files[0]);
  });
}
$("theme").onclick = () => {
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  const now = document.documentElement.dataset.theme ?? (dark ? "dark" : "light");
  document.documentElement.dataset.theme = now === "dark" ? "light" : "dark";
  localStorage.setItem("hapslam-theme", document.documentElement.dataset.theme);
  view?.restyle();
};
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => view?.restyle());
if (localStorage.getItem("hapslam-theme")) document.documentElement.dataset.theme = localStorage.getItem("hapslam-theme");
addEventListener("hashchange", route);
route();
