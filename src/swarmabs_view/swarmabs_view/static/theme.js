// Light, dark, or the system's theme. Not a module, so that it runs before the first paint and nothing flashes.
"use strict";
(() => {
  const KEY = "swarmabs-theme";
  const CHOICES = ["auto", "light", "dark"];
  const system = matchMedia("(prefers-color-scheme: dark)");
  let chosen = "auto";
  try {
    chosen = localStorage.getItem(KEY) || "auto";
  } catch {
    // Storage may be blocked; then the choice lasts until the page is closed.
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
