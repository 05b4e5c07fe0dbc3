// Calls of the service. Errors carry the problem document's detail.

const STORED = "hapslam-key";

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

export async function upload(path, file) {
  const binary = { "Content-Type": "application/octet-stream" };
  return (await checked(await fetch(path, { method: "POST", body: file, headers: headers(binary) }))).json();
}

export async function download(path, name) {
  const blob = await (await checked(await fetch(path, { headers: headers() }))).blob();
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

// Server-sent events through fetch, so that a key can be sent along. Comes back with
// Last-Event-ID after a break, so nothing is missed.
export async function* events(path, first, signal) {
  let next = first;
  while (!signal.aborted) {
    try {
      const answer = await checked(await fetch(`${path}?first=${next}`, { headers: headers(), signal }));
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      let text = "";
      for (;;) {
        const { value, done } = await reader.read();
        if (done) break;
        text += value;
        const blocks = text.split("\n\n");
        text = blocks.pop();
        for (const block of blocks) {
          const event = Object.fromEntries(
            block.split("\n").filter((line) => !line.startsWith(":")).map((line) => {
              const at = line.indexOf(": ");
              return [line.slice(0, at), line.slice(at + 2)];
            }),
          );
          if (event.event === "deleted") return;
          if (event.event === "epoch") {
            const state = JSON.parse(event.data);
            next = state.epoch + 1;
            yield state;
          }
        }
      }
    } catch (error) {
      if (signal.aborted) return;
      if (error instanceof Problem && error.status < 500) throw error;
    }
    await new Promise((resolve) => setTimeout(resolve, 1000));
  }
}
