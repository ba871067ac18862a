// Who this phone is, for good; and the token that it came with.

const [ID, NAME, TOKEN] = ["posed.phone.id", "posed.phone.name", "posed.phone.token"];

/** Made once. */
export function id(): string {
  const kept = localStorage.getItem(ID);
  if (kept !== null && /^[A-Za-z0-9_-]{1,32}$/.test(kept)) return kept;
  const bytes = crypto.getRandomValues(new Uint8Array(4));
  const made = `phone-${[...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("")}`;
  localStorage.setItem(ID, made);
  return made;
}

export const name = (): string => localStorage.getItem(NAME) ?? "";
export const rename = (name: string): void => localStorage.setItem(NAME, name);

/** The token of `#k=` is kept and taken out of the address, so that the history has none. */
export function token(): string | null {
  const address = new URL(location.href);
  const given = new URLSearchParams(address.hash.slice(1)).get("k") ?? address.searchParams.get("k");
  if (given !== null) {
    localStorage.setItem(TOKEN, given);
    address.hash = "";
    address.searchParams.delete("k");
    history.replaceState(null, "", address);
  }
  return localStorage.getItem(TOKEN);
}
