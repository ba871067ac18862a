// Was der Daemon auf Englisch sagt, auf Deutsch: Probleme nach ihrem Code, Haltungen und Bewegungen, um die eine Kalibrierung bittet, einzelne Wörter.

import type { FieldAsk, LinkState, Problem, RefusalReason } from "../../../clients/typescript/src/posed.v1";
import type { AlignAsked, ImuAsked } from "./en";

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
  ros2_router: ({ at }) => `Unter ${at} antwortet kein Router von ROS 2: ihn mit \`ros2 run rmw_zenoh_cpp rmw_zenohd\` starten, oder seine Adresse als ros2.connect angeben.`,
  ros2_slow: ({ lost }) => `zenoh ist zu langsam für diese Stage: In der letzten Sekunde sind ${lost} Nachrichten an ROS 2 weggefallen.`,
  timecode_rate: ({ code, stated }) => `Der Timecode zählt ${code} Bilder je Sekunde, und timecode.rate sagt ${stated}: den Generator oder die Stage-Datei berichtigen.`,
  tracking: ({ times, begun_anew }) => `Die Verfolgung hatte einen eigenen Fehler und ging ohne die Bytes weiter, die ihn brachten (${times} Mal${begun_anew === "0" ? "" : `, ${begun_anew} Mal ganz von vorn, mit neu eingerichteten Geräten`}): bitte mit einer Aufnahme melden.`,
  vanished: () => "Der Hub sieht diese Stage nicht mehr: Ihr Daemon ist beendet, oder das Netz zu ihr ist unterbrochen. Was zu sehen ist, ist alt.",
  version: ({ version }) => `Dort läuft posed ${version}, das eine andere Fassung der Sprache des Hubs spricht.`,
  wall_clock: ({ jump_s }) => `Die Uhr des Rechners wurde um ${jump_s} s verstellt. Zeiten dieses Laufs zählen weiter von seinem Beginn: posed neu starten, bevor mit anderen Rechnern verglichen wird.`,
  zenoh_certificate: ({ at, reason }) => `Keine Verbindung zu ${at}: Die Zertifikate passen nicht (${reason}).`,
  zenoh_password: ({ at }) => `Keine Verbindung zu ${at}: Dort wird dieser Name mit diesem Passwort abgelehnt, oder eine andere Fassung von zenoh gesprochen.`,
  zenoh_refused: ({ at }) => `Keine Verbindung zu ${at}: Dort werden ein Name und ein Passwort verlangt, oder eine andere Fassung von zenoh gesprochen.`,
  zenoh_slow: ({ lost }) => `zenoh ist zu langsam für diese Stage: In der letzten Sekunde sind ${lost} Nachrichten an andere Rechner weggefallen.`,
  zenoh_speaks_plain: ({ at }) => `Keine Verbindung zu ${at}: Dort wird nicht verschlüsselt; tcp/ vor die Adresse schreiben, oder dort [zenoh.tls] angeben.`,
  zenoh_speaks_tls: ({ at }) => `Keine Verbindung zu ${at}: Dort wird nur verschlüsselt verbunden; tls/ vor die Adresse schreiben, und [zenoh.tls] angeben.`,
  zenoh_twin: ({ key }) => `Ein anderer Daemon läuft unter dem Schlüssel ${key} auf zenoh, und Hubs halten beide für einen: einen beenden, oder ihm einen anderen Namen oder zenoh.key geben.`,
  zenoh_unreachable: ({ at, reason }) => `Keine Verbindung zu ${at}: ${reason}. Läuft es dort, und stimmt die Adresse?`,
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

/** Um was die Kalibrierung einer IMU bittet: mit den Richtungen, den Seiten, die fehlen, und wie viel vom Feld gesehen ist, in Prozent. */
export const IMU_ASKS: Record<ImuAsked["asks"], (count: string, missing: string, field: number) => string> = {
  another: (count) => `${count}: Diese ist bekannt; die Einheit auf eine andere Seite oder Kante drehen`,
  keep: (count) => `${count}: so liegen lassen`,
  side: (count, missing) => `${count}: die Einheit auf eine andere Seite legen und 2 s ruhen lassen; noch nicht oben waren: ${missing}`,
  edge: (count) => `${count}: die Einheit auf eine Kante oder Ecke stellen und 2 s ruhen lassen`,
  field: (_count, _missing, field) => `Vom Feld ist ${field} % dessen gesehen, was nötig ist: die Einheit langsam durch alle Richtungen drehen, fern von Eisen`,
};

export const ALIGN_ASKS: Record<Exclude<AlignAsked["asks"], "anchor">, string> = {
  wave: "Den Sensor schnell um alle seine Achsen hin und her drehen, um 45 Grad und mehr, und weitermachen",
  other_axis: "Den Sensor um eine andere Achse drehen als bisher, um 45 Grad und mehr",
};

export const DONE = {
  imu: "Die Kennwerte der Einheit sind gefunden, aufbewahrt und in Gebrauch.",
  alignment: "Es ist bekannt, wie der Sender steht.",
};

/** Eine Richtung: eine Achse, wo sie nahe einer liegt. */
function direction(along: [number, number, number]): string {
  const sizes = along.map(Math.abs);
  const most = sizes.indexOf(Math.max(...sizes));
  if (sizes[most]! > 0.9) return ["x", "y", "z"][most]!;
  const sign = along[most]! < 0 ? -1 : 1;
  return `(${along.map((part) => (sign * part).toFixed(1)).join(", ")})`;
}

/** Was mit dem Stab zu tun ist. */
export function fieldAsked(asks: FieldAsk): string {
  switch (asks.ask) {
    case "show": return "Den Stab bewegen: Noch ist keiner seiner Sensoren zu sehen.";
    case "move": return "Den Stab bewegen.";
    case "begin": return `Nur ${asks.instants} brauchbare Zeitpunkte: den Stab eine Minute lang bewegen.`;
    case "carry": return `Die Mitte des Stabs hat sich nur ${(1000 * asks.moved_m).toFixed(0)} mm entlang ${direction(asks.along)} bewegt: weiter in diese Richtung tragen.`;
    case "hold": return `Der Stab wurde kaum je entlang ${direction(asks.along)} gehalten: so halten.`;
    case "hold_once": return `Der Stab wurde nie entlang ${direction(asks.along)} gehalten.`;
    case "visit": return `Nur ${(100 * asks.visited).toFixed(0)} % des Raums wurden besucht: in die Nähe von ${asks.near_m.map((m, i) => `${"xyz"[i]} = ${m.toFixed(1)} m`).join(", ")} gehen.`;
    case "go_on": return "Den Stab weiter schwenken.";
  }
}

/** Warum eine Bitte abgelehnt wurde, und was zu tun ist. */
export const REFUSED: Record<RefusalReason, (values: Record<string, string>) => string> = {
  bad_name: () => "Der Name darf nur Buchstaben, Ziffern, „-“, „_“ und „.“ haben.",
  file_changed: () => "Jemand anderes hat die Stage-Datei inzwischen geändert: die Seite neu laden.",
  hub: () => "Ein Hub zeigt seine Stages nur: den Daemon der Stage selbst darum bitten.",
  is_read: () => "Ein Vorgang liest die Aufnahme gerade: abwarten oder abbrechen.",
  is_recorded: () => "Die Aufnahme läuft noch: erst beenden.",
  is_watched: () => "Jemand sieht sich die Aufnahme an: erst schließen.",
  is_written: () => "Ein anderes Programm schreibt die Aufnahme: erst beenden.",
  job_runs: ({ job }) => `${job} läuft: Die Stage ändert sich, sobald es beendet ist.`,
  jobs_run: ({ count }) => `Es laufen schon ${count} Vorgänge: einen abwarten oder abbrechen.`,
  no_attached_imu: ({ name }) => `An „${name}“ ist keine IMU befestigt: drei vermessene Punkte oder mehr angeben, oder \`imu\` bei ihm in die Stage-Datei schreiben.`,
  no_body: () => "Diese Stage hat keinen Körper.",
  no_file: () => "Dieser Daemon wurde nicht mit einer eigenen Stage-Datei gestartet (`posed demo` zeigt simulierte Geräte): eine mit `posed run --new stage.toml` beginnen.",
  no_imu: () => "Diese Stage hat keine IMU.",
  no_magnetic: () => "Diese Stage hat keinen magnetischen Sensor.",
  no_sensor: ({ name }) => `Diese Stage hat keinen Sensor „${name}“.`,
  no_take: ({ name }) => `Es gibt keine Aufnahme „${name}“.`,
  not_magnetic: ({ name }) => `„${name}“ ist kein magnetischer Sensor dieser Stage.`,
  nothing_collected: () => "Es wurde nichts gesammelt: beginnen und den Stab bewegen.",
  pole_sensors: () => "Drei Sensoren oder mehr angeben, jeden einmal, in ihrer Reihenfolge entlang des Stabs.",
  pole_spacing: () => "Den gemessenen Abstand der Sensoren angeben, größer als 0.",
  repetitions: () => "2 bis 100 Wiederholungen angeben; 3 bis 10 sind gut.",
  requests_wait: () => "Zu viele Bitten warten: gleich noch einmal versuchen.",
  session_runs: ({ person }) => `Eine Sitzung von „${person}“ läuft: erst beenden.`,
  take_exists: ({ name }) => `Es gibt schon eine Aufnahme „${name}“: einen anderen Namen wählen.`,
  watches: () => "Mit diesem Token lässt sich nur zusehen: Es braucht eines mit der Rolle `operate`.",
};

/** Was mit einem Gerät ist; warum, sagt der Daemon auf Englisch. */
export const DEVICES: Record<LinkState, string> = {
  streaming: "sendet", connecting: "Es wird verbunden; bleibt es dabei, Strom, Kabel und Port prüfen.",
  silent: "Es kommt nichts: Strom und Kabel prüfen.", failed: "Das Gerät verweigert den Dienst: aus- und wieder einschalten.",
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
