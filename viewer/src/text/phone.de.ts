// Alles, was die Seite auf einem Telefon sagt, auf Deutsch.

import type { PhoneText } from "./phone.en";

export const de: PhoneText = {
  title: "Dieses Telefon als Sensor", here: "Hier ist es", start: "Start", stop: "Stopp", language: "Sprache", name: "Name dieses Telefons", placeholder: "linker Oberschenkel",
  before: "Erst Start drücken, dann das Telefon umschnallen. Seine Bewegung geht an die Stage, sonst nichts.",
  link: {
    idle: "Nicht gestartet", connecting: "Verbinde mit der Stage …", lost: (why) => `Die Verbindung ist weg (${why}). Neuer Versuch.`,
    replaced: "Eine andere Seite dieses Telefons hat übernommen. Start sendet wieder von hier.",
    refused: "Der Code gilt nicht mehr. Den neuen scannen, den „Einrichten“ zeigt.",
    open: "Verbunden", hidden: "Angehalten: Diese Seite war nicht zu sehen.",
  },
  refusal: {
    insecure: "Der Browser gibt hier keine Bewegung her: Die Adresse muss mit https beginnen. Den Code scannen, den „Einrichten“ zeigt.",
    denied: "Bewegung wurde nicht erlaubt. Diese Seite neu laden, Start drücken und erlauben; oder Bewegungssensoren in den Einstellungen des Browsers erlauben.",
    none: "Von diesem Gerät kommt keine Bewegung: Es hat vielleicht keine Sensoren, oder der Browser hält sie zurück.",
    no_gyroscope: "Dieses Gerät hat kein Gyroskop, das ein Sensor am Körper braucht.",
  },
  stage: {
    found: (stage) => `${stage} sieht dieses Telefon. Dort platzieren: Einrichten, Telefon hinzufügen.`,
    waiting: "Die Stage wartet auf seine Messwerte.", streaming: "Es wird verfolgt.",
  },
  figures: { sensor: "Sensor", segment: "Sitzt an", rate: "Rate", lost: "Verloren", orientation: "Orientierung" },
  rate: (hz) => `${hz} Hz`, lost: (n, share) => `${n} (${share} %)`, nowhere: "an keinem Segment", withOrientation: "wird gesendet", withoutOrientation: "wird nicht gesendet",
  problems: "Probleme", screenSleeps: "Der Bildschirm lässt sich hier nicht wach halten: Die längste Zeit bis zur Sperre einstellen.",
  guide: {
    title: "Achsen prüfen", help: "Browser haben verschiedene Vorzeichen. Das dauert eine halbe Minute und berichtigt sie.", begin: "Prüfen", cancel: "Abbrechen",
    steps: {
      flat: "Das Telefon flach auf einen Tisch legen, Bildschirm nach oben, und loslassen.", upright: "Aufstellen: die kurze Kante auf den Tisch, der Bildschirm zeigt zu Ihnen.",
      down: "Wieder flach hinlegen, wie zuvor.", turn: "Auf dem Tisch um ein Viertel nach links drehen und loslassen.",
    },
    asSpecified: "Vorzeichen und Achsen stimmen.", corrected: "Ein Vorzeichen oder die Folge der Achsen war falsch. Ab jetzt wird das auf diesem Telefon berichtigt.",
    unclear: "Die Bewegungen wurden nicht erkannt. Noch einmal prüfen, eine Bewegung nach der anderen.", signFound: "Das Vorzeichen der Beschleunigung war falsch. Es ist berichtigt.",
  },
  trust: {
    title: "Wenn der Browser vor dieser Seite warnt", help: "Die Stage hat ihr Zertifikat selbst gemacht. Erst den Fingerabdruck mit dem in „Einrichten“ vergleichen, dann vertrauen.",
    load: "Zertifikat laden",
    android: "Android: bei der Warnung weitergehen (Erweitert); oder das Zertifikat laden und unter Einstellungen, Sicherheit, Zertifikat installieren, CA-Zertifikat einrichten.",
    ios: "iPhone, iPad: mit Safari laden, das Profil zulassen, unter Einstellungen, Allgemein, VPN und Geräteverwaltung installieren, dann unter Einstellungen, Allgemein, Info, Zertifikatsvertrauenseinstellungen vertrauen.",
  },
  segments: {
    head: "Kopf", torso: "Brust", pelvis: "Becken", shoulder_r: "rechte Schulter", shoulder_l: "linke Schulter", upper_arm_r: "rechter Oberarm", upper_arm_l: "linker Oberarm",
    forearm_r: "rechter Unterarm", forearm_l: "linker Unterarm", hand_r: "rechte Hand", hand_l: "linke Hand", thigh_r: "rechter Oberschenkel", thigh_l: "linker Oberschenkel", shank_r: "rechter Unterschenkel", shank_l: "linker Unterschenkel", foot_r: "rechter Fuß", foot_l: "linker Fuß",
  },
};
