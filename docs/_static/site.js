// Embedded replays follow the theme of the page.
const theme = () => {
  const chosen = document.body.dataset.theme;
  if (chosen === "dark" || chosen === "light") return chosen;
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
};
const paint = () => {
  for (const frame of document.querySelectorAll("iframe.replay"))
    frame.contentWindow.postMessage({ theme: theme() }, "*");
};
new MutationObserver(paint).observe(document.body, { attributeFilter: ["data-theme"] });
for (const frame of document.querySelectorAll("iframe.replay")) frame.addEventListener("load", paint);

// The theme marks captions of the side bar as headings, but gives them no level.
for (const caption of document.querySelectorAll(".caption[role=heading]")) caption.ariaLevel = 2;
