// The page: the token, the plant, which view is shown, and how the connection is.
import { Poll, ask } from "./api.js";
import { AxisView } from "./axis.js";
import { ownerOf } from "./alarms.js";
import { el, say } from "./dom.js";
import { Overview } from "./overview.js";
import { Plant } from "./plant.js";
import { icon } from "./states.js";
import { startTheme } from "./theme.js";
import { forgetToken, setToken, takeToken } from "./token.js";

const main = document.getElementById("main");
const connection = document.getElementById("connection");
const lost = document.getElementById("lost");
const OVERVIEW = 500, AXIS = 250; // time between two requests [ms]
let plant = null, view = null, poll = null, lostAt = null;

function showConnection({ live, retry, problem, status }) {
  document.body.classList.toggle("stale", !live);
  if (live) {
    lostAt = null;
    lost.hidden = true;
    connection.dataset.live = "yes";
    say(connection, "live");
    return;
  }
  if (status === 401) return askForToken("This token opens nothing here; the service may have been started anew.");
  lostAt ??= new Date();
  if (plant) plant.version = 0; // the service may have started again
  connection.dataset.live = "no";
  say(connection, "not connected");
  lost.hidden = false;
  const since = lostAt.toLocaleTimeString([], { hour12: false });
  say(lost, `No connection since ${since}: ${problem}. What you see is old. Trying again in ${Math.ceil(retry / 1000)} s.`);
}

function announce(alarms) {
  const spoken = document.getElementById("spoken");
  for (const alarm of alarms) spoken.append(el("span", {}, `Alarm of ${ownerOf(alarm)}: ${alarm.text}. `));
  while (spoken.childNodes.length > 5) spoken.firstChild.remove();
}

// In sight wherever someone has scrolled to, and whichever axis they look at.
function showCount(open) {
  const pill = document.getElementById("alarmed");
  pill.hidden = open === 0;
  if (pill.dataset.count === String(open)) return;
  pill.dataset.count = open;
  pill.replaceChildren(icon("alarm"), String(open), el("span", { class: "wide" }, ` open alarm${open === 1 ? "" : "s"}`));
}

function take(message) {
  if (message.layout !== plant.layout) return start();
  announce(plant.take(message));
  if (message.rows) view?.take?.(message.rows);
  const open = plant.openAlarms().length;
  showCount(open);
  const where = [open ? `▲ ${open} alarm${open > 1 ? "s" : ""}` : null, view?.axis, plant.name];
  document.title = where.filter(Boolean).join(" · ");
  view?.update();
}

// arrived: by a link, so that the keyboard and a screen reader go on at the top of what is new.
function show(arrived = false) {
  if (!plant) return;
  poll?.stop();
  view?.stop();
  const axis = location.hash.startsWith("#/axis/") ? decoded(location.hash.slice(7)) : null;
  const known = axis !== null && plant.place.has(axis);
  view = known ? new AxisView(plant, axis) : new Overview(plant);
  const gone = axis !== null && !known ? [el("p", { class: "note", role: "alert" }, "There is no axis of that name.")] : [];
  main.replaceChildren(...gone, view.element);
  view.entered?.();
  scrollTo(0, 0);
  if (arrived) main.focus({ preventScroll: true });
  plant.version = 0; // the news of an axis leave out the others
  const rows = known ? () => `&axis=${encodeURIComponent(axis)}&after=${view.after}` : () => "";
  poll = new Poll(() => `api/news?since=${plant.version}${rows()}`, known ? AXIS : OVERVIEW, take, showConnection);
}

function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

async function start() {
  poll?.stop();
  try {
    plant = new Plant(await (await ask("api/plant")).json());
  } catch (error) {
    if (error.status === 401) return askForToken("");
    showConnection({ live: false, retry: 3000, problem: error.message });
    setTimeout(start, 3000);
    return;
  }
  document.getElementById("plant").textContent = plant.name;
  show();
}

function askForToken(problem) {
  poll?.stop();
  view?.stop();
  view = null;
  plant = null;
  forgetToken();
  lost.hidden = true;
  document.body.classList.remove("stale");
  say(connection, "no token");
  const field = el("input", { id: "token", type: "password", autocomplete: "off", spellcheck: "false" });
  const submit = (event) => {
    event.preventDefault();
    setToken(field.value.trim());
    start();
  };
  main.replaceChildren(
    el(
      "form",
      { class: "token", onsubmit: submit },
      el("h1", {}, "Token"),
      el("p", {}, "Open the address that pmfid serve printed when it started, or enter your token."),
      problem ? el("p", { role: "alert", class: "problem" }, problem) : null,
      el("label", { for: "token" }, "Token"),
      field,
      el("button", { class: "strong" }, "Open"),
    ),
  );
  field.focus();
}

takeToken();
startTheme(document.getElementById("theme"));
document.getElementById("skip").addEventListener("click", () => main.focus());
addEventListener("hashchange", () => {
  if (location.hash.includes("token=")) {
    takeToken();
    start();
  } else show(true);
});
start();
