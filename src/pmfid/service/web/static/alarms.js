// Alarms as cards, and the dialog in which one is acknowledged with a note.
import { Problem, tell } from "./api.js";
import { el } from "./dom.js";
import { moment, number, wall } from "./format.js";
import { isOpen } from "./plant.js";
import { icon } from "./states.js";

const sinceOf = (alarm) => (alarm.silent ? "" : `This change began at ${moment(alarm.changed_at)}. `) + `The service noticed it at ${wall(alarm.wall)}.`;

// How sure an alarm is.
const sureOf = (alarm) =>
  `How sure: the evidence is ${number(alarm.statistic / alarm.threshold, 2)} times what an alarm needs. ` +
  "While nothing is wrong, an alarm occurs about once in the time that mtbf_hours in AXIS.toml sets.";

export function alarmCard(alarm, withAxis = true) {
  const known = !isOpen(alarm);
  const button = el(
    "button",
    { type: "button", class: "strong", onclick: () => acknowledge(alarm), "aria-label": `Acknowledge the alarm of ${ownerOf(alarm)}` },
    "Acknowledge …",
  );
  return el(
    "li",
    { class: known ? "card known" : "card alarm", "data-alarm": alarm.number },
    icon(known ? "watching" : "alarm"),
    el(
      "div",
      { class: "card-text" },
      el(
        "p",
        { class: "card-title" },
        withAxis && alarm.axis ? el("a", { href: axisLink(alarm.axis) }, alarm.axis) : null,
        withAxis ? " " : null,
        el("strong", {}, alarm.text),
      ),
      known || !alarm.advice ? null : el("p", {}, `What to do: ${alarm.advice}`),
      known || !alarm.size ? null : el("p", {}, `How urgent: ${alarm.size}.`),
      el("p", { class: "fine" }, sinceOf(alarm), alarm.silent ? "" : alarm.now ? ` The values are ${alarm.now}.` : " The new value is not known yet."),
      alarm.silent ? null : el("p", { class: "fine" }, sureOf(alarm)),
      alarm.cleared === null ? null : el("p", { class: "fine" }, `back since ${wall(alarm.cleared)}`),
      alarm.acknowledged === null ? null : el("p", { class: "fine note-text" }, `acknowledged ${wall(alarm.acknowledged)}`, alarm.note ? `: “${alarm.note}”` : ""),
    ),
    known ? null : button,
  );
}

export const ownerOf = (alarm) => alarm.axis || `the ${alarm.silent} ${alarm.name}`;

export const axisLink = (name) => `#/axis/${encodeURIComponent(name)}`;

export function acknowledge(alarm) {
  const note = el("textarea", { id: "note", maxlength: "500", rows: "4" });
  askFirst(
    "Acknowledge the alarm",
    [
      el("p", {}, el("strong", {}, ownerOf(alarm)), `: ${alarm.text}`),
      el("label", { for: "note" }, "Note for those who come after you"),
      note,
    ],
    "Acknowledge",
    () => tell(`api/alarms/${alarm.number}/acknowledge`, { note: note.value }),
  );
}

// A dialog with one action, which also shows the reason if the action fails.
export function askFirst(title, content, action, act) {
  const problem = el("p", { role: "alert", class: "problem" });
  const dialog = el("dialog", { "aria-labelledby": "dialog-title" });
  const submit = async (event) => {
    event.preventDefault();
    try {
      await act();
      dialog.close();
    } catch (error) {
      problem.textContent = error instanceof Problem ? error.message : "the service does not answer; try again";
    }
  };
  const cancel = el("button", { type: "button", onclick: () => dialog.close() }, "Cancel");
  const buttons = el("div", { class: "buttons" }, cancel, el("button", { class: "strong" }, action));
  dialog.append(el("form", { onsubmit: submit }, el("h2", { id: "dialog-title" }, title), ...content, problem, buttons));
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}
