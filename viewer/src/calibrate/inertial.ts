// Sensors whose intrinsics can be found: those that send angular velocity and specific force.

import { live } from "../page.svelte";

/** Drivers whose units send both. */
const DRIVERS = ["xbus", "x-imu3"];

export function inertialSensors(): string[] {
  const devices = new Set(live.status?.devices.filter(({ driver }) => DRIVERS.includes(driver)).map(({ name }) => name));
  return live.hello?.sensors.filter(({ device }) => devices.has(device)).map(({ name }) => name) ?? [];
}
