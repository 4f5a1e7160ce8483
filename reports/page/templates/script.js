"use strict";
const filter = document.getElementById("filter");
if (filter) {
  const named = document.querySelectorAll("[data-find]");
  const narrow = () => {
    const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const item of named) {
      const text = item.dataset.find.toLowerCase();
      item.hidden = !words.every((word) => text.includes(word));
    }
  };
  filter.addEventListener("input", narrow);
  filter.closest(".filter").hidden = false;
  narrow();
}
for (const stack of document.querySelectorAll("button.stack")) {
  stack.addEventListener("click", () => {
    const large = stack.closest("figure").classList.toggle("large");
    stack.setAttribute("aria-pressed", String(large));
  });
}
