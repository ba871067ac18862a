// All that the page on a phone says, in English: apart from the rest, so that a phone need not load that.

export const en = {
  title: "This phone as a sensor", here: "Here it is", start: "Start", stop: "Stop", language: "Language", name: "Name of this phone", placeholder: "left thigh",
  before: "Press Start, then strap the phone on. Its motion goes to the stage, and nothing else does.",
  link: {
    idle: "Not started", connecting: "Connecting to the stage …", lost: (why: string) => `The connection is lost (${why}). Trying again.`,
    replaced: "Another page of this phone has taken over. Press Start to send from here.",
    refused: "The code is no longer valid. Scan the new one that Set up shows.",
    open: "Connected", hidden: "Paused: this page was not visible.",
  },
  refusal: {
    insecure: "The browser gives no motion here: the address has to begin with https. Scan the code that Set up shows.",
    denied: "Motion was not allowed. Load this page again, press Start, and allow it; or allow motion sensors in the settings of the browser.",
    none: "No motion comes from this device: it may have no sensors, or the browser keeps them back.",
    no_gyroscope: "This device has no gyroscope, which a sensor on the body needs.",
  },
  stage: {
    found: (stage: string) => `${stage} sees this phone. Place it there: Set up, Add a phone.`,
    waiting: "The stage waits for its measurements.", streaming: "It is tracked.",
  },
  figures: { sensor: "Sensor", segment: "Sits on", rate: "Rate", lost: "Lost", orientation: "Orientation" },
  rate: (hz: string) => `${hz} Hz`, lost: (n: number, share: string) => `${n} (${share} %)`, nowhere: "on no segment", withOrientation: "sent", withoutOrientation: "not sent",
  problems: "Problems", screenSleeps: "The screen cannot be kept awake here: set its time-out to the longest there is.",
  guide: {
    title: "Check the axes", help: "Browsers differ in signs. This takes half a minute and corrects them.", begin: "Check", cancel: "Cancel",
    steps: {
      flat: "Lay the phone flat on a table, screen up, and let go.", upright: "Stand it up: the short edge on the table, the screen towards you.",
      down: "Lay it flat again, as before.", turn: "Turn it left on the table by a quarter, and let go.",
    },
    asSpecified: "Signs and axes are right.", corrected: "A sign or the order of the axes was wrong. It is corrected from now on, on this phone.",
    unclear: "The movements were not recognised. Check again, one movement at a time.", signFound: "The sign of the acceleration was wrong. It is corrected.",
  },
  trust: {
    title: "If the browser warns of this page", help: "The stage has made its own certificate. Compare its fingerprint with that in Set up before you trust it.",
    load: "Load the certificate",
    android: "Android: go on at the warning (Advanced); or load the certificate and install it under Settings, Security, Install a certificate, CA certificate.",
    ios: "iPhone, iPad: load it with Safari, allow the profile, install it under Settings, General, VPN & Device Management, then trust it under Settings, General, About, Certificate Trust Settings.",
  },
  segments: {
    head: "head", torso: "chest", pelvis: "pelvis", shoulder_r: "right shoulder", shoulder_l: "left shoulder", upper_arm_r: "right upper arm", upper_arm_l: "left upper arm",
    forearm_r: "right forearm", forearm_l: "left forearm", hand_r: "right hand", hand_l: "left hand", thigh_r: "right thigh", thigh_l: "left thigh", shank_r: "right shank", shank_l: "left shank", foot_r: "right foot", foot_l: "left foot",
  } as Record<string, string>,
};

export type PhoneText = typeof en;
