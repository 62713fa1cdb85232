// Requests with the token, and streams of lines that come back by themselves.
import { token } from "./token.js";

const SILENT = 6000; // a service that says nothing for so long [ms] is gone: it speaks every second
const PAUSES = [500, 1000, 2000, 4000, 8000, 15000];

export class Problem extends Error {
  constructor(status, text) {
    super(text);
    this.status = status;
  }
}

export async function ask(path, options = {}) {
  // Without a token, a proxy may know its users, and send the token in their place.
  const headers = { ...(token() ? { authorization: `Bearer ${token()}` } : {}), ...options.headers };
  const answer = await fetch(path, { ...options, headers, credentials: token() ? "omit" : "same-origin", cache: "no-store" });
  if (!answer.ok) {
    const said = await answer.json().catch(() => ({}));
    throw new Problem(answer.status, said.problem ?? `the service answers ${answer.status}`);
  }
  return answer;
}

export const tell = (path, content) =>
  ask(path, { method: "POST", body: JSON.stringify(content), headers: { "content-type": "application/json" } });

async function* linesOf(answer, alive) {
  const reader = answer.body.getReader();
  const decoder = new TextDecoder();
  let rest = [];
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    alive();
    const parts = decoder.decode(value, { stream: true }).split("\n");
    while (parts.length > 1) {
      rest.push(parts.shift());
      const line = rest.join("");
      rest = [];
      if (line) yield JSON.parse(line);
    }
    rest.push(parts[0]);
  }
}

// Follows a stream until `stop` is called. take(message); tellState({live, retry, problem, status}).
export class Stream {
  constructor(path, take, tellState) {
    this.path = path;
    this.take = take;
    this.tellState = tellState;
    this.stopped = false;
    this.run();
  }

  stop() {
    this.stopped = true;
    this.abort?.abort();
  }

  async run() {
    let attempt = 0;
    while (!this.stopped) {
      const problem = await this.once(() => (attempt = 0));
      if (this.stopped) return;
      const pause = PAUSES[Math.min(attempt++, PAUSES.length - 1)] * (0.8 + 0.4 * Math.random());
      this.tellState({ live: false, retry: pause, problem: problem.message, status: problem.status });
      if (problem.status === 401) return;
      await new Promise((resolve) => setTimeout(resolve, pause));
    }
  }

  async once(connected) {
    this.abort = new AbortController();
    let watchdog;
    const alive = () => {
      clearTimeout(watchdog);
      watchdog = setTimeout(() => this.abort.abort(), SILENT);
    };
    try {
      alive();
      const answer = await ask(this.path, { signal: this.abort.signal });
      let first = true;
      for await (const message of linesOf(answer, alive)) {
        if (this.stopped) break;
        if (first) {
          connected();
          this.tellState({ live: true });
          first = false;
        }
        this.take(message);
      }
      return new Problem(0, "the service ended the stream");
    } catch (error) {
      return error instanceof Problem ? error : new Problem(0, "the service does not answer");
    } finally {
      clearTimeout(watchdog);
    }
  }
}
