// Addresses of recordings and of what is made from them: at the root of the daemon, from the stage's page and from a take's.

import { tokenOf } from "../link";

/** Whether this is the page of a take beside a live stage, and not that of `posed replay`. */
export const isTake = /\/takes\/[^/]+\/$/.test(location.pathname);
/** From here to the stage's page. */
export const ROOT = isTake ? "../../" : "./";

/** The page of a take. */
export const takePage = (name: string): string => `${ROOT}takes/${encodeURIComponent(name)}/`;

/** A file that the daemon serves, with the token that it asks for. */
export const fileAt = (folder: "recordings" | "exports", name: string): string => withToken(`${ROOT}${folder}/${encodeURIComponent(name)}`);

function withToken(address: string): string {
  const token = tokenOf(location);
  return token === null ? address : `${address}?token=${encodeURIComponent(token)}`;
}

export type RemoteTake = { name: string; bytes: number };

/** What the stage has whose page a hub shows. */
export async function remoteTakes(): Promise<RemoteTake[]> {
  const answer = await fetch(withToken(`${ROOT}recordings`));
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json() as Promise<RemoteTake[]>;
}
