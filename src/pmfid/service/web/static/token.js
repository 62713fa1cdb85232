// The token of this tab. It comes in the fragment of the address, which a browser sends to nobody, and is taken out of
// it at once, so that it stays in no history and on no shared screen. It is kept in sessionStorage: a page that stands
// open for weeks survives a reload, a closed tab forgets it, and no other origin (another port is one) can read it.
const KEY = "pmfid-token";

export function takeToken() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem(KEY, given);
    history.replaceState(null, "", location.pathname + "#/");
  }
}

export const token = () => sessionStorage.getItem(KEY) ?? "";

export function setToken(value) {
  sessionStorage.setItem(KEY, value);
}

export function forgetToken() {
  sessionStorage.removeItem(KEY);
}
