// What the package offers: the client, and the types of all messages.

export { Client, Refused, websocketOf } from "./client.js";
export type { AnswerTo, Choice, LinkState, Message, Options, Request } from "./client.js";
export type * from "./posed.v1.js";
