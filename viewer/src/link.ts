// The page's connection: at the address beside it, with the token of its tab, and what of the stage it wants how often.

import { Client, Refused, type LinkState, websocketOf } from "../../clients/typescript/src/client";
import { DRAWN_HZ } from "./pace";
import type { Field, ServerMessage, Topic } from "./protocol";

export { type LinkState, Refused };

/** What the views show of each sensor. */
const FIELDS: Field[] = ["device", "position_m", "orientation_wxyz", "sigma_m", "measured", "fault", "change"];
/** States that are drawn: so many a second as this browser draws. */
const DRAWN: Topic[] = ["sensors", "truth", "body"];
const TOKEN_KEY = "posed.token";

/**
 * The token of this tab. One in the page's address (`?token=` or `#token=`) is kept for the tab and taken out of the address, so
 * that neither the history nor a copied link has it.
 */
export function tokenOf(page: Location): string | null {
  const address = new URL(page.href);
  const hash = new URLSearchParams(address.hash.slice(1));
  const given = address.searchParams.get("token") ?? hash.get("token");
  if (given !== null) {
    sessionStorage.setItem(TOKEN_KEY, given);
    address.searchParams.delete("token");
    if (hash.has("token")) address.hash = "";
    history.replaceState(history.state, "", address);
  }
  return sessionStorage.getItem(TOKEN_KEY);
}

export class Link extends Client {
  /** `page`: another one than this, to connect beside; `feeds`: whether it wants what the stage publishes, and not only answers. */
  constructor(onMessage: (message: ServerMessage) => void, onState: (state: LinkState, why: string) => void, page = () => location.href, feeds = true) {
    super(() => websocketOf(page()), { onMessage, onState, token: () => tokenOf(location) });
    if (!feeds) return;
    this.useRate(DRAWN_HZ);
    this.on("hello", ({ topics }) => this.subscribe({ topics: topics.filter((topic) => !DRAWN.includes(topic)) }));
  }

  /** The token is kept for this tab and tried at once. */
  useToken(token: string): void {
    sessionStorage.setItem(TOKEN_KEY, token);
    this.connect();
  }

  /** So many states a second are enough. */
  useRate(rate_hz: number): void {
    this.subscribe({ topics: DRAWN, max_rate_hz: rate_hz, fields: FIELDS });
  }
}
