// Light or dark: as the system wishes, until somebody chooses.

export type Theme = "auto" | "dark" | "light";
const KEY = "posed.theme";
const dark = matchMedia("(prefers-color-scheme: dark)");

class Look {
  #theme = $state<Theme>("auto");
  #dark = $state(dark.matches);

  constructor() {
    const kept = localStorage.getItem(KEY);
    if (kept === "dark" || kept === "light") this.theme = kept;
    dark.addEventListener("change", () => (this.#dark = dark.matches));
  }

  get theme(): Theme {
    return this.#theme;
  }

  set theme(theme: Theme) {
    this.#theme = theme;
    if (theme === "auto") {
      delete document.documentElement.dataset["theme"];
      localStorage.removeItem(KEY);
    } else {
      document.documentElement.dataset["theme"] = theme;
      localStorage.setItem(KEY, theme);
    }
  }

  get isDark(): boolean {
    return this.#theme === "auto" ? this.#dark : this.#theme === "dark";
  }
}

export const look = new Look();

/** A colour of theme.css as it is now, for what CSS does not draw. */
export function token(name: string): string {
  // Asked of a property that is a colour, so that the answer is one whatever the token is made of.
  const probe = document.createElement("span");
  probe.style.color = `var(--${name})`;
  document.body.append(probe);
  const { color } = getComputedStyle(probe);
  probe.remove();
  return color;
}
