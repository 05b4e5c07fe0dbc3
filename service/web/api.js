// Calls of the service. Errors carry the problem document's detail.

const STORED = "hapslam-key";
const RETRY_MS = 1000; // before a stream that broke is opened again
const HIDDEN_POLL_MS = 10_000; // between two questions of a tab that nobody sees

export const key = {
  get: () => sessionStorage.getItem(STORED) ?? "",
  set: (value) => sessionStorage.setItem(STORED, value),
};

function headers(more = {}) {
  return key.get() ? { Authorization: `Bearer ${key.get()}`, ...more } : more;
}

export class Problem extends Error {
  constructor(status, detail) {
    super(detail);
    this.status = status;
  }
}

async function checked(answer) {
  if (answer.ok) return answer;
  const problem = await answer.json().catch(() => ({}));
  throw new Problem(answer.status, problem.detail ?? answer.statusText);
}

export async function get(path) {
  return (await checked(await fetch(path, { headers: headers() }))).json();
}

export async function send(method, path, body) {
  const json = { "Content-Type": "application/json" };
  const content = body === undefined ? {} : { body: JSON.stringify(body), headers: headers(json) };
  const answer = await checked(await fetch(path, { method, headers: headers(), ...content }));
  return answer.status === 204 ? null : answer.json();
}

// Sends a file; `told` is called with the share that was sent.
export function upload(path, file, told) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", path);
    const all = headers({ "Content-Type": "application/octet-stream" });
    for (const [name, value] of Object.entries(all)) request.setRequestHeader(name, value);
    request.upload.onprogress = (event) => told(event.loaded / (event.total || 1));
    request.onerror = () => reject(new Problem(0, "The service could not be reached."));
    request.onload = () => {
      let body = {};
      try {
        body = JSON.parse(request.responseText);
      } catch { /* an answer of a proxy, perhaps */ }
      if (request.status < 300) resolve(body);
      else reject(new Problem(request.status, body.detail ?? request.statusText));
    };
    request.send(file);
  });
}

export async function download(path, name) {
  const blob = await (await checked(await fetch(path, { headers: headers() }))).blob();
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

// Resolves when the tab is shown or hidden, or after some time.
function turned(milliseconds) {
  return new Promise((resolve) => {
    const done = () => {
      clearTimeout(timer);
      document.removeEventListener("visibilitychange", done);
      resolve();
    };
    const timer = setTimeout(done, milliseconds);
    document.addEventListener("visibilitychange", done);
  });
}

// Events of an answer: name and data.
async function* parts(body) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    text += value;
    const blocks = text.split("\n\n");
    text = blocks.pop();
    for (const block of blocks) {
      yield Object.fromEntries(
        block.split("\n").filter((line) => !line.startsWith(":")).map((line) => {
          const at = line.indexOf(": ");
          return [line.slice(0, at), line.slice(at + 2)];
        }),
      );
    }
  }
}

// Server-sent events through fetch, so that a key can be sent along. Comes back after a break with
// the epoch that is next, so nothing is missed. A browser has six connections to a server for all its
// tabs: only a tab that is seen keeps a stream open, a hidden one asks now and then.
export async function* events(path, first, signal, link) {
  let next = first;
  while (!signal.aborted) {
    const hidden = document.hidden, stop = new AbortController();
    const end = () => stop.abort();
    signal.addEventListener("abort", end);
    if (!hidden) document.addEventListener("visibilitychange", end);
    try {
      const query = `first=${next}&follow=${!hidden}`;
      const answer = await checked(await fetch(`${path}?${query}`, { headers: headers(), signal: stop.signal }));
      link(true);
      for await (const event of parts(answer.body)) {
        if (event.event === "deleted") return;
        if (event.event === "epoch") {
          const state = JSON.parse(event.data);
          next = state.epoch + 1;
          yield state;
        }
      }
    } catch (error) {
      if (signal.aborted) return;
      if (error instanceof Problem && error.status < 500 && error.status !== 429) throw error;
      if (error.name !== "AbortError") link(false);
    } finally {
      signal.removeEventListener("abort", end);
      document.removeEventListener("visibilitychange", end);
    }
    await turned(hidden && document.hidden ? HIDDEN_POLL_MS : RETRY_MS);
  }
}
