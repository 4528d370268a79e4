// Theme and layout. Not a module, so that it runs before the first paint and nothing flashes.
"use strict";
(() => {
  // A choice that the browser keeps; `apply` shows it.
  class Choice {
    constructor(key, choices, apply) {
      [this.key, this.choices, this.apply, this.chosen] = [key, choices, apply, choices[0]];
      try {
        this.chosen = localStorage.getItem(key) || this.chosen;
      } catch {
        // Storage may be blocked; then the choice lasts until the page is closed.
      }
      if (!choices.includes(this.chosen)) {
        this.chosen = choices[0];
      }
      this.show();
    }

    show() {
      this.apply(this.chosen);
      window.dispatchEvent(new Event("appearancechange"));
    }

    // Choose the next one and return it.
    next() {
      this.chosen = this.choices[(this.choices.indexOf(this.chosen) + 1) % this.choices.length];
      try {
        localStorage.setItem(this.key, this.chosen);
      } catch {
        // as above
      }
      this.show();
      return this.chosen;
    }
  }

  const shown = document.documentElement.dataset;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const theme = new Choice("swarmabs-theme", ["auto", "light", "dark"], (chosen) => {
    shown.theme = chosen === "auto" ? (dark.matches ? "dark" : "light") : chosen;
  });
  dark.addEventListener("change", () => theme.show());
  const layout = new Choice("swarmabs-layout", ["full", "presenter"], (chosen) => {
    shown.layout = chosen;
  });
  window.swarmabsAppearance = { theme, layout };
})();
