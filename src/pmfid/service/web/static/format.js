// Numbers, times and names for people.
export const words = (name) => String(name).replaceAll("_", " ");
export const unitOf = (unit) => (unit ? " " + unit : "");

export function number(value, digits = 4) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(Math.max(0, digits - 2)).replace("-", "−");
  const decimals = size === 0 ? 0 : Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  return value.toFixed(Math.min(decimals, 8)).replace("-", "−");
}

// A value with as many decimals as its standard deviation has two digits.
export function withError(value, std) {
  if (!Number.isFinite(std) || !Number.isFinite(value)) return "not known yet";
  if (!(std > 0)) return number(value);
  const size = Math.max(Math.abs(value), std);
  if (size < 1e-3 || size >= 1e6) return `${number(value)} ± ${number(std, 2)}`;
  const decimals = Math.min(8, Math.max(0, 1 - Math.floor(Math.log10(std))));
  return `${value.toFixed(decimals).replace("-", "−")} ± ${std.toFixed(decimals)}`;
}

export function percent(part) {
  if (!Number.isFinite(part)) return "–";
  const value = 100 * part;
  const text = Math.abs(value) >= 100 ? value.toFixed(0) : value.toFixed(1);
  const signed = Number(text) > 0 ? "+" + text : Number(text) === 0 ? "0.0" : text.replace("-", "−");
  return `${signed}\u00a0%`;
}

export function age(seconds) {
  if (!Number.isFinite(seconds)) return "never";
  if (seconds < 10) return `${Math.max(0, seconds).toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} d`;
}

// A clock that counts from 1970 is shown as time of day, another in seconds.
export const isWall = (seconds) => seconds > 1e8;

export function moment(seconds) {
  if (!Number.isFinite(seconds)) return "–";
  return isWall(seconds) ? wall(seconds) : `${seconds.toFixed(2)} s`;
}

export function wall(seconds) {
  const date = new Date(1000 * seconds);
  const today = new Date().toDateString() === date.toDateString();
  const time = date.toLocaleTimeString([], { hour12: false });
  return today ? time : `${date.toLocaleDateString()} ${time}`;
}
