// Was der Daemon auf Englisch sagt, auf Deutsch: Probleme nach ihrem Code, Haltungen und Bewegungen, um die eine Kalibrierung bittet, einzelne Wörter.

import type { Problem } from "../../../clients/typescript/src/posed.v1";

type Values = Problem["values"];

/** Was mit dem Sensor auf einem Segment ist, und was zu tun ist. */
const SENSOR: Record<string, string> = {
  missing: "sendet nichts: Akku und Kabel prüfen", not_finite: "sendet Zahlen, die nicht endlich sind", stuck: "wiederholt sich: aus- und wieder einschalten", saturated: "ist am Ende seines Messbereichs",
  misfit: "bewegt sich nicht, wie sein Segment es kann: Sein Gurt ist verrutscht (ein kalibriertes Glied zeigt durch seine Bewegungen, wie er nun sitzt), oder er ist mit einem anderen vertauscht",
  swapped: "sitzt hier, wie Bewegungen gezeigt haben, und zählt hier, nicht wo die Stage-Datei ihn hat: dort berichtigen, oder jedes Glied kalibrieren",
};

/** Mit einem Satz, den der Daemon nur auf Englisch hat, bleibt dieser stehen. */
export const PROBLEMS: Record<string, (values: Values) => string | null> = {
  battery: ({ sensor, percent }) => `Der Akku von ${sensor} ist bei ${percent} %: bitte laden.`,
  body_not_calibrated: ({ of }) => `${of ?? ""}Niemand weiß, wie die Sensoren auf dem Körper sitzen: den Körper kalibrieren, oder mounting = "given" mit \`mount_quat_wxyz\` für jeden angeben.`,
  body_sensor: ({ of, segment, sensor, cause }) => (SENSOR[cause ?? ""] ? `${of ?? ""}${term(segment ?? "")}: Der Sensor ${sensor} ${SENSOR[cause!]}.` : null),
  connections: ({ times }) => `${times} Verbindungen wurden abgewiesen, weil zu viele offen sind oder auf einmal kommen: Programme beenden, die immer wieder verbinden.`,
  load: ({ late_ms }) => `Dieser Rechner kommt nicht mit: Eines von hundert Bildern ist mehr als ${late_ms} ms nach seinen Bytes fertig, und Geräte können verstummen. Andere Programme beenden, oder weniger Sensoren oder mit kleinerer Rate verfolgen.`,
  recording: ({ reason }) => `Die Aufnahme ist abgebrochen: ${reason}`,
  tracking: ({ times, begun_anew }) => `Die Verfolgung hatte einen eigenen Fehler und ging ohne die Bytes weiter, die ihn brachten (${times} Mal${begun_anew === "0" ? "" : `, ${begun_anew} Mal ganz von vorn, mit neu eingerichteten Geräten`}): bitte mit einer Aufnahme melden.`,
  vanished: () => "Der Hub sieht diese Stage nicht mehr: Ihr Daemon ist beendet, oder das Netz zu ihr ist unterbrochen. Was zu sehen ist, ist alt.",
  version: ({ version }) => `Dort läuft posed ${version}, das eine andere Fassung der Sprache des Hubs spricht.`,
  wall_clock: ({ jump_s }) => `Die Uhr des Rechners wurde um ${jump_s} s verstellt. Zeiten dieses Laufs zählen weiter von seinem Beginn: posed neu starten, bevor mit anderen Rechnern verglichen wird.`,
  zenoh_slow: ({ lost }) => `zenoh ist zu langsam für diese Stage: In der letzten Sekunde sind ${lost} Nachrichten an andere Rechner weggefallen.`,
  zenoh_twin: ({ key }) => `Ein anderer Daemon läuft unter dem Schlüssel ${key} auf zenoh, und Hubs halten beide für einen: einen beenden, oder ihm einen anderen Namen oder zenoh.key geben.`,
};

const then = (what: string) => `${what}, dreimal; dann still stehen`;
const elbow = (side: string) => then(`Den ${side} Ellbogen beugen und wieder hängen lassen`);
const knee = (side: string) => then(`Das ${side} Knie beugen, Ferse nach hinten`);
const thigh = (side: string) => then(`Den ${side} Oberschenkel nach vorn heben`);
const arm = (side: string) => then(`Den gestreckten ${side} Arm nach vorn heben`);
const shrug = (side: string) => then(`Die ${side} Schulter zum Ohr heben und sinken lassen, Arm hängend`);
const wrist = (side: string) => then(`Das ${side} Handgelenk zur Handfläche beugen und zurück`);
const foot = (side: string) => then(`Die Zehen des ${side} Fußes heben, Ferse am Boden`);

export const ASKS: Record<string, string> = {
  n_pose: "Aufrecht stehen, Arme hängen, Handflächen am Körper, und still halten",
  t_pose: "Beide Arme seitlich auf Schulterhöhe heben, Handflächen nach unten, Daumen nach vorn, und still halten",
  bow: "Mit geradem Rücken nach vorn beugen und wieder aufrichten, zweimal; dann still stehen",
  walk: "Umhergehen wie gewohnt, immer vorwärts, mit schwingenden Armen, geradeaus und in Kurven, eine halbe Minute lang",
  trunk_rotation: "Die Brust nach links drehen und zurück, zweimal, Hüfte still; dann still stehen",
  neck_flexion: then("Nicken, Kinn zur Brust und wieder hoch"),
  elbow_flexion_r: elbow("rechten"), elbow_flexion_l: elbow("linken"), knee_flexion_r: knee("rechte"), knee_flexion_l: knee("linke"),
  hip_flexion_r: thigh("rechten"), hip_flexion_l: thigh("linken"), shoulder_flexion_r: arm("rechten"), shoulder_flexion_l: arm("linken"),
  shrug_r: shrug("rechte"), shrug_l: shrug("linke"), wrist_flexion_r: wrist("rechte"), wrist_flexion_l: wrist("linke"), ankle_flexion_r: foot("rechten"), ankle_flexion_l: foot("linken"),
};

/** Ursachen von Fehlern, Gelenke, ihre Winkel, Segmente: ganz, sonst Wort für Wort. */
const TERMS: Record<string, string> = {
  hemisphere_inversion: "gespiegelt", vertical_inversion: "senkrecht gespiegelt", stuck: "hängt", gate: "nicht, wo es sein kann", missing: "fehlt", not_finite: "nicht endlich", saturated: "am Ende des Messbereichs",
  misfit: "passt nicht zum Segment", swapped: "vertauscht", jump: "Sprung", bone: "wo Gelenke es nicht erlauben", map: "von der Fehlerkarte erkannt", distance: "weit von allem Gelernten", faulty: "fehlerhaft",
  head: "Kopf", torso: "Brust", pelvis: "Becken", upper_arm: "Oberarm", forearm: "Unterarm", hand: "Hand", thigh: "Oberschenkel", shank: "Unterschenkel", foot: "Fuß",
  spine: "Wirbelsäule", neck: "Nacken", shoulder: "Schulter", elbow: "Ellbogen", wrist: "Handgelenk", hip: "Hüfte", knee: "Knie", ankle: "Knöchel",
  flexion: "Beugung", abduction: "Abspreizung", rotation: "Drehung", pronation: "Pronation", elevation: "Hebung", lateral_flexion: "Seitneigung", lateral: "seitlich", plane: "Ebene", deviation: "Abweichung", protraction: "Vorschub", inversion: "Inversion", tilt: "Neigung", adduction: "Anspreizung", sternoclavicular: "Schlüsselbein",
  too_fast: "zu schnell", too_slow: "zu langsam", too_small: "zu klein", too_large: "zu groß", different: "anders", incomplete: "unvollständig", too_soon: "zu früh",
};

export function term(word: string): string {
  const known = TERMS[word];
  if (known) return known;
  const side = /_([rl])(?=_|$)/.exec(word)?.[1];
  const rest = side ? word.replace(`_${side}`, "") : word;
  const says = TERMS[rest] ?? rest.split("_").map((part) => TERMS[part] ?? part).join(" ");
  return side ? `${says} ${side === "r" ? "rechts" : "links"}` : says;
}
