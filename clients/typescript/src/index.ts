// What the package offers: the client, a take in the place of a stage, and the types of all messages.

export { Client, Refused, websocketOf } from "./client.js";
export { mockStage } from "./mock.js";
export type { MockOptions } from "./mock.js";
export type { AnswerTo, Choice, LinkState, Message, Options, Request } from "./client.js";
export type * from "./posed.v1.js";
