// Names for what the theme leaves without one, or with half of one, for screen readers.
for (const button of document.querySelectorAll(".search-button__button")) {
  if (button.innerText.trim()) button.removeAttribute("aria-label"); // "Search Ctrl+K" is its name
}
for (const summary of document.querySelectorAll("details > summary")) {
  const link = summary.closest("li")?.querySelector("a");
  if (link && !summary.innerText.trim()) {
    summary.setAttribute("aria-label", `Pages under ${link.innerText.trim()}`);
  }
}
// What scrolls sideways can be scrolled by keys.
addEventListener("load", () => {
  for (const equation of document.querySelectorAll("div.math")) {
    if (equation.scrollWidth > equation.clientWidth) equation.tabIndex = 0;
  }
});
