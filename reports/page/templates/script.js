"use strict";
const all = (selector, root = document) => [...root.querySelectorAll(selector)];

// Show only what has all the words that are typed.
const narrow = (name, items, textOf) => {
  const input = document.getElementById(name);
  if (!input) return;
  const apply = () => {
    const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
    for (const item of items) {
      const text = textOf(item).toLowerCase();
      item.hidden = !words.every((word) => text.includes(word));
    }
  };
  input.addEventListener("input", apply);
  input.closest(".filter").hidden = false;
  apply();
};
narrow("filter", all("[data-find]"), (item) => item.dataset.find);
narrow("method-filter", all("#methods tbody tr"), (row) => row.querySelector("th").textContent);
narrow("output-filter", all("#gallery figure.output"), (one) => one.dataset.method);

// Sort tables by a column; reference rows are a body of their own and stay below.
for (const table of all("table.sortable")) {
  const heads = all("thead th", table);
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.className = "sort";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const before = head.getAttribute("aria-sort");
      const first = head.dataset.first || "ascending";
      const other = first === "ascending" ? "descending" : "ascending";
      const way = before === first ? other : first;
      heads.forEach((one) => one.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", way);
      const sign = way === "ascending" ? 1 : -1;
      const key = (row) => row.children[column].dataset.value ?? row.children[column].textContent.trim();
      for (const body of table.tBodies) {
        const rows = [...body.rows];
        rows.sort((a, b) => {
          const [x, y] = [key(a), key(b)];
          if (x === "" || y === "") return (x === "") - (y === "");
          const gap = Number(x) - Number(y);
          return sign * (Number.isNaN(gap) ? x.localeCompare(y) : gap);
        });
        body.append(...rows);
      }
    });
  });
}

// Show one replicate of a texture at a time.
for (const article of all("#gallery article")) {
  const draws = all(".draw", article);
  if (draws.length < 2) continue;
  const group = article.querySelector(".replicates");
  const show = (chosen) => {
    draws.forEach((draw, index) => { draw.hidden = index !== chosen; });
    all("button", group).forEach((button, index) => button.setAttribute("aria-pressed", String(index === chosen)));
  };
  draws.forEach((draw, index) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = draw.dataset.replicate;
    button.setAttribute("aria-label", `replicate ${draw.dataset.replicate}`);
    button.addEventListener("click", () => show(index));
    group.append(button);
  });
  group.hidden = false;
  show(0);
}
const reveal = () => {
  const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (target?.hidden) {
    const input = document.getElementById("output-filter");
    input.value = "";
    input.dispatchEvent(new Event("input"));
    target.scrollIntoView();
  }
  const draw = target && target.closest(".draw");
  if (!draw || !draw.hidden) return;
  const index = all(".draw", draw.parentElement).indexOf(draw);
  all(".replicates button", draw.closest("article"))[index].click();
  target.scrollIntoView();
};
addEventListener("hashchange", reveal);
reveal();

// Zoom and move all pictures of a texture together.
for (const article of all("#gallery article")) {
  const bar = article.querySelector(".zoom");
  const state = { zoom: 1, x: 0, y: 0 };
  const apply = () => {
    for (const view of all(".view", article)) {
      const image = view.querySelector("img");
      if (state.zoom > 1 && image.dataset.full && !image.dataset.small) {
        image.dataset.small = image.src;
        image.addEventListener("error", () => { image.src = image.dataset.small; }, { once: true });
        image.src = image.dataset.full;
      }
      const limit = (size) => size * (state.zoom - 1);
      const x = Math.min(0, Math.max(-limit(view.clientWidth), state.x));
      const y = Math.min(0, Math.max(-limit(view.clientHeight), state.y));
      view.querySelector(".pan").style.transform = state.zoom > 1 ? `translate(${x}px, ${y}px) scale(${state.zoom})` : "";
    }
    article.classList.toggle("zoomed", state.zoom > 1);
    bar.querySelector("output").textContent = `${state.zoom}×`;
  };
  const clamp = (view) => {
    state.x = Math.min(0, Math.max(-view.clientWidth * (state.zoom - 1), state.x));
    state.y = Math.min(0, Math.max(-view.clientHeight * (state.zoom - 1), state.y));
  };
  const largest = () => all(".view", article).reduce((a, b) => (b.clientWidth > a.clientWidth ? b : a));
  const zoomTo = (zoom, view = largest(), px = view.clientWidth / 2, py = view.clientHeight / 2) => {
    const next = Math.min(16, Math.max(1, zoom));
    state.x = px - (px - state.x) * (next / state.zoom);
    state.y = py - (py - state.y) * (next / state.zoom);
    state.zoom = next;
    clamp(view);
    apply();
  };
  const move = (dx, dy) => {
    state.x += dx;
    state.y += dy;
    clamp(largest());
    apply();
  };
  if (!article.querySelector(".view")) continue;
  bar.hidden = false;
  bar.addEventListener("click", (event) => {
    const way = event.target.closest("button")?.dataset.zoom;
    if (way === "in") zoomTo(state.zoom * 2);
    if (way === "out") zoomTo(state.zoom / 2);
    if (way === "reset") zoomTo(1);
  });
  for (const view of all(".view", article)) {
    view.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      const box = view.getBoundingClientRect();
      zoomTo(state.zoom * (event.deltaY < 0 ? 2 : 0.5), view, event.clientX - box.left, event.clientY - box.top);
    }, { passive: false });
    let from = null;
    view.addEventListener("pointerdown", (event) => {
      if (state.zoom > 1) from = { x: event.clientX, y: event.clientY, moved: false };
    });
    view.addEventListener("pointermove", (event) => {
      if (!from || !event.buttons) return;
      const [dx, dy] = [event.clientX - from.x, event.clientY - from.y];
      if (!from.moved && Math.abs(dx) + Math.abs(dy) < 4) return;
      if (!from.moved) view.setPointerCapture(event.pointerId);
      from = { x: event.clientX, y: event.clientY, moved: true };
      move(dx, dy);
    });
    view.addEventListener("click", (event) => {
      const dragged = from && from.moved;
      from = null;
      if (dragged) event.stopImmediatePropagation();
    });
    view.addEventListener("keydown", (event) => {
      const step = 48;
      const moves = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
      if (event.key === "+" || event.key === "=") zoomTo(state.zoom * 2);
      else if (event.key === "-") zoomTo(state.zoom / 2);
      else if (event.key === "0") zoomTo(1);
      else if (state.zoom > 1 && moves[event.key]) move(...moves[event.key]);
      else return;
      event.preventDefault();
    });
  }
}

// Enlarge an output.
for (const stack of all("button.stack")) {
  stack.addEventListener("click", () => {
    const large = stack.closest("figure").classList.toggle("large");
    stack.setAttribute("aria-pressed", String(large));
  });
}

// Scores below outputs have the descriptions of the glossary.
const meanings = new Map(all(".glossary tbody tr").map((row) => {
  const [name, meaning, unit, range, better] = [...row.cells].map((cell) => cell.textContent.trim());
  return [name, `${meaning}\nunit: ${unit}; range: ${range}; better: ${better}`];
}));
for (const head of all(".scores th")) head.title = meanings.get(head.textContent.trim()) ?? "";

// Copy tables.
for (const button of all("button[data-copy]")) {
  button.hidden = false;
  button.addEventListener("click", async () => {
    const text = document.getElementById(button.dataset.copy).textContent;
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      const area = document.createElement("textarea");
      area.value = text;
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
    const status = document.getElementById("copied");
    status.textContent = `${button.textContent}: done`;
  });
}

// Paper shows all pictures, also those that were never scrolled to.
addEventListener("beforeprint", () => {
  for (const image of all("img[loading=lazy]")) image.loading = "eager";
});
