// The search button's visible text, "Search Ctrl+K", is its name; the theme's label hides half of it.
for (const button of document.querySelectorAll(".search-button__button")) {
  button.removeAttribute("aria-label");
}
