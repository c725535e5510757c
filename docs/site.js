"use strict";
/* What the theme leaves out: a name for the search, and the focus for what scrolls. */
document.addEventListener("DOMContentLoaded", () => {
  document.querySelector(".md-search")?.setAttribute("aria-label", "Search");
  const scrolling = () => {
    for (const box of document.querySelectorAll(".md-typeset__scrollwrap, .equation .formula, .highlight code"))
      if (box.scrollWidth > box.clientWidth) box.tabIndex = 0;
  };
  setTimeout(scrolling, 0);
  window.addEventListener("resize", scrolling);
});
