// Light, dark, or as the system has it; and the colours of the style sheet for what is drawn.
const CHOICES = ["auto", "light", "dark"];
const WORDS = { auto: "auto", light: "light", dark: "dark" };
const heard = new Set();

function apply(choice, button) {
  if (choice === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = choice;
  button.textContent = `Theme: ${WORDS[choice]}`;
  for (const callback of heard) callback();
}

export function startTheme(button) {
  let choice = localStorage.getItem("pmfid-theme");
  if (!CHOICES.includes(choice)) choice = "auto";
  apply(choice, button);
  button.addEventListener("click", () => {
    choice = CHOICES[(CHOICES.indexOf(choice) + 1) % CHOICES.length];
    localStorage.setItem("pmfid-theme", choice);
    apply(choice, button);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => apply(choice, button));
}

// Calls back when colours change; returns what ends that.
export function onTheme(callback) {
  heard.add(callback);
  return () => heard.delete(callback);
}

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
