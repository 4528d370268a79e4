// Light, dark, or as the system says. It is no module, so that the page does not flash in the other colours first.
"use strict";
(() => {
  const KEY = "swarmabs-theme";
  const CHOICES = ["auto", "light", "dark"];
  const system = matchMedia("(prefers-color-scheme: dark)");
  let chosen = "auto";
  try {
    chosen = localStorage.getItem(KEY) || "auto";
  } catch {
    // Storage may be forbidden; then the choice lasts as long as the page.
  }
  if (!CHOICES.includes(chosen)) {
    chosen = "auto";
  }
  const apply = () => {
    document.documentElement.dataset.theme = chosen === "auto" ? (system.matches ? "dark" : "light") : chosen;
    window.dispatchEvent(new Event("themechange"));
  };
  window.swarmabsTheme = {
    get: () => chosen,
    next() {
      chosen = CHOICES[(CHOICES.indexOf(chosen) + 1) % CHOICES.length];
      try {
        localStorage.setItem(KEY, chosen);
      } catch {
        // as above
      }
      apply();
      return chosen;
    },
  };
  system.addEventListener("change", apply);
  apply();
})();
