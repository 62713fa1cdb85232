// Elements made of names and texts. Nothing here, or anywhere in this page, parses HTML: what comes from the plant is
// text, whatever it looks like, and the Content-Security-Policy refuses the rest.
export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (value === true) made.setAttribute(name, "");
    else if (value !== false && value != null) made.setAttribute(name, value);
  }
  const shown = children.filter((child) => child != null);
  made.append(...shown.map((child) => (typeof child === "string" ? child.replaceAll(" %", "\u00a0%") : child)));
  return made;
}

export function svg(tag, attributes = {}, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

// Writes a text only where it is another: a screen reader and the layout are left alone otherwise.
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function download(name, text, kind) {
  const url = URL.createObjectURL(new Blob([text], { type: kind }));
  const link = el("a", { href: url, download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10000);
}
