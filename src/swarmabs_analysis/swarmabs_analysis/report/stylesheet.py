"""How a report looks, in light and dark, on a narrow screen and on paper; it refers to nothing outside of the page."""

STYLESHEET = """
:root {
  color-scheme: light dark;
  --paper: #ffffff; --ink: #1a1a1a; --quiet: #5c5c5c; --line: #d9d9d9; --panel: #f7f7f8;
  --grey: #767676; --light: #f0f0f0; --grid: #dddddd;
  --orange: #e69f00; --sky: #56b4e9; --green: #009e73; --yellow: #f0e442;
  --blue: #0072b2; --vermilion: #d55e00; --purple: #cc79a7;
  --good: #00694d; --bad: #a63c00;
}
@media screen and (prefers-color-scheme: dark) {
  :root {
    --paper: #16181c; --ink: #e8e8e8; --quiet: #a8abb0; --line: #3a3d44; --panel: #1e2127;
    --grey: #9a9a9a; --light: #23262c; --grid: #34373e;
    --orange: #f0b429; --sky: #7cc7f2; --green: #2cc295; --yellow: #f0e442;
    --blue: #55aef0; --vermilion: #ff8243; --purple: #e6a3c8;
    --good: #4fd6ac; --bad: #ff9d6b;
  }
}
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; text-size-adjust: 100%; }
body {
  margin: 0 auto; padding: 1.5rem clamp(0.8rem, 3vw, 2rem) 3rem; max-width: 84rem;
  background: var(--paper); color: var(--ink);
  font: 0.95rem/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif;
}
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 0.4rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 0.8rem; padding-bottom: 0.25rem; border-bottom: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 1.4rem 0 0.5rem; }
p { max-width: 48rem; margin: 0.5rem 0; }
a { color: var(--blue); }
.status { font-weight: 600; }
.good { color: var(--good); }
.bad { color: var(--bad); }
.quiet, figcaption p, caption { color: var(--quiet); }
nav ul { display: flex; flex-wrap: wrap; gap: 0.2rem 1.1rem; list-style: none; margin: 1rem 0 0; padding: 0; }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(15rem, 1fr)); gap: 0.7rem 1.5rem; margin: 1rem 0; }
dl div { border-left: 3px solid var(--line); padding-left: 0.7rem; min-width: 0; }
dt { color: var(--quiet); font-size: 0.82rem; }
dd { margin: 0; overflow-wrap: anywhere; font-variant-numeric: tabular-nums; }
dl .wide { grid-column: 1 / -1; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 30rem), 1fr)); gap: 1rem; }
figure { margin: 0; padding: 0.7rem 0.8rem; background: var(--panel); border: 1px solid var(--line);
  border-radius: 6px; break-inside: avoid; min-width: 0; }
figure h3 { margin: 0 0 0.3rem; }
figcaption p { font-size: 0.82rem; line-height: 1.4; margin: 0.3rem 0 0; }
svg { display: block; width: 100%; height: auto; max-width: 42rem; margin: 0 auto; }
svg * { stroke-linejoin: round; stroke-linecap: butt; }
svg text { fill: var(--ink); font-family: "DejaVu Sans", Verdana, Helvetica, Arial, sans-serif; }
.table { overflow-x: auto; margin: 0.6rem 0; }
table { border-collapse: collapse; font-size: 0.88rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-size: 0.85rem; padding-bottom: 0.3rem; }
th, td { text-align: left; vertical-align: top; padding: 0.28rem 1.2rem 0.28rem 0;
  border-bottom: 1px solid var(--line); }
thead th { color: var(--quiet); font-weight: 600; }
tbody th { font-weight: 500; }
pre { overflow-x: auto; background: var(--panel); border: 1px solid var(--line); border-radius: 6px;
  padding: 0.8rem; font: 0.8rem/1.45 ui-monospace, "DejaVu Sans Mono", monospace; }
code { font: 0.88em ui-monospace, "DejaVu Sans Mono", monospace; overflow-wrap: anywhere; }
summary { cursor: pointer; }
footer { margin-top: 3rem; color: var(--quiet); font-size: 0.82rem; }
@media print {
  body { max-width: none; padding: 0; font-size: 9.5pt; }
  nav { display: none; }
  .figures { grid-template-columns: 1fr 1fr; }
  figure, tr { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
  pre { white-space: pre-wrap; overflow-wrap: anywhere; }
}
"""
