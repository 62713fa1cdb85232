// Requests with the token, and repeated requests for what is new.
import { token } from "./token.js";

const SILENT = 6000; // a service that does not answer for so long [ms] is gone
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

// Asks for what is new until `stop` is called. path() says what to ask for, every [ms]; take(message);
// tellState({live, retry, problem, status}).
export class Poll {
  constructor(path, every, take, tellState) {
    Object.assign(this, { path, every, take, tellState });
    this.stopped = false;
    this.run();
  }

  stop() {
    this.stopped = true;
    this.abort?.abort();
  }

  async run() {
    let failures = 0;
    while (!this.stopped) {
      const problem = await this.once();
      if (this.stopped) return;
      let pause = this.every;
      if (problem) {
        pause = PAUSES[Math.min(failures++, PAUSES.length - 1)] * (0.8 + 0.4 * Math.random());
        this.tellState({ live: false, retry: pause, problem: problem.message, status: problem.status });
        if (problem.status === 401) return;
      } else failures = 0;
      await new Promise((resolve) => setTimeout(resolve, pause));
    }
  }

  async once() {
    this.abort = new AbortController();
    const watchdog = setTimeout(() => this.abort.abort(), SILENT);
    try {
      const message = await (await ask(this.path(), { signal: this.abort.signal })).json();
      if (this.stopped) return null;
      this.tellState({ live: true });
      this.take(message);
      return null;
    } catch (error) {
      return error instanceof Problem ? error : new Problem(0, "the service does not answer");
    } finally {
      clearTimeout(watchdog);
    }
  }
}
