"use strict";
const content = JSON.parse(document.getElementById("content").textContent);
const place = "nrbench-labels-" + content.sheet;
const part = (id) => document.getElementById(id);
const rows = [...document.querySelectorAll(".question")];
const each = content.questions.length;
const last = content.items.length * each;
let given = {};
let at = -1;
let pictured = -1;
let drawn = null;
let since = 0;

// A step is one question about one item.
const item = (step) => Math.floor(step / each);
function known(step) {
  return (given[content.items[item(step)][0]] || {})[content.questions[step % each]];
}
function restore() {
  try {
    const kept = JSON.parse(localStorage.getItem(place) || "{}");
    given = kept.given || {};
    part("who").value = kept.who || "";
  } catch (error) {
    given = {};
  }
}
function keep() {
  try {
    localStorage.setItem(place, JSON.stringify({ given, who: part("who").value }));
  } catch (error) {
    part("warning").textContent = "This browser keeps nothing: save your answers before you close the page.";
  }
}
function first() {
  let step = 0;
  while (step < last && known(step)) step += 1;
  return step;
}
function picture(image, index) {
  image.src = "data:image/png;base64," + content.pictures[index];
  return image.decode();
}
function fit() {
  const [sample, output] = [part("sample"), part("output")];
  if (!sample.naturalWidth || !output.naturalWidth) return;
  const bars = ["header", "footer"].reduce((sum, name) => sum + document.querySelector(name).offsetHeight, 0);
  const width = innerWidth - 90;
  const height = innerHeight - bars - 70;
  const asked = part("questions");
  // The questions stand below the sample, beside the output.
  const room = Math.min(
    width / (sample.naturalWidth + output.naturalWidth),
    (width - asked.offsetWidth) / output.naturalWidth,
    height / output.naturalHeight,
    (height - asked.offsetHeight - 10) / sample.naturalHeight
  );
  const scale = room >= 1 ? Math.min(4, Math.floor(room)) : Math.max(0.25, room);
  for (const image of [sample, output]) {
    image.width = Math.round(image.naturalWidth * scale);
    image.height = Math.round(image.naturalHeight * scale);
  }
}
async function draw(index) {
  pictured = index;
  const [, sample, output] = content.items[index];
  await Promise.all([picture(part("sample"), sample), picture(part("output"), output)]);
  if (pictured === index) fit();
}
async function show(step) {
  at = step;
  const outputs = content.items.length;
  const done = content.items.filter(([id]) => Object.keys(given[id] || {}).length === each).length;
  const working = at >= 0 && at < last;
  part("start").hidden = at >= 0;
  part("work").hidden = !working;
  part("end").hidden = at < last;
  part("bar").value = Object.values(given).reduce((sum, one) => sum + Object.keys(one).length, 0) / last;
  part("count").textContent = working ? `${item(at) + 1} of ${outputs}, ${done} answered` : `${done} of ${outputs} answered`;
  part("save").disabled = !Object.keys(given).length;
  if (!working) return;
  rows.forEach((row, i) => {
    const own = at - (at % each) + i;
    if (own === at) row.setAttribute("aria-current", "step");
    else row.removeAttribute("aria-current");
    for (const choice of row.querySelectorAll("button")) {
      choice.setAttribute("aria-pressed", String(known(own)?.answer === choice.dataset.answer));
      choice.disabled = own > at && !known(own);
    }
  });
  part("back").disabled = at === 0;
  part("forward").disabled = !known(at);
  since = Infinity;
  if (pictured !== item(at)) drawn = draw(item(at));
  await drawn;
  if (at === step) since = performance.now();
}
function answer(step, word) {
  if (since === Infinity) return;
  const [id] = content.items[item(step)];
  given[id] = { ...given[id], [content.questions[step % each]]: { answer: word, seconds: (performance.now() - since) / 1000 } };
  keep();
  show(step + 1);
}
function table() {
  const lines = content.items.flatMap(([id], i) =>
    content.questions.flatMap((question) => {
      const one = (given[id] || {})[question];
      return one ? [[id, question, one.answer, one.seconds.toFixed(2), i + 1, "person"].join(",")] : [];
    })
  );
  return ["item,question,answer,seconds,order,labeled_by", ...lines, ""].join("\r\n");
}
function save() {
  const who = part("who").value.trim().replace(/[^\p{L}\p{N}]+/gu, "-");
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([table()], { type: "text/csv" }));
  link.download = `labels-${content.sheet}${who ? "-" + who : ""}.csv`;
  link.click();
  keep();
}
document.addEventListener("keydown", (event) => {
  if (event.repeat || event.ctrlKey || event.metaKey || event.altKey || event.target === part("who")) return;
  if (at < 0) {
    if (event.key === "Enter") {
      event.preventDefault();
      show(first());
    }
    return;
  }
  const number = ["1", "2", "3"].indexOf(event.key);
  if (number >= 0 && at < last) answer(at, content.answers[number]);
  else if (event.key === "ArrowLeft" && at > 0) show(at - 1);
  else if (event.key === "ArrowRight" && at < last && known(at)) show(at + 1);
  else return;
  event.preventDefault();
});
rows.forEach((row, i) => {
  for (const choice of row.querySelectorAll("button")) {
    choice.addEventListener("click", () => answer(at - (at % each) + i, choice.dataset.answer));
  }
});
part("begin").addEventListener("click", () => show(first()));
part("back").addEventListener("click", () => show(at - 1));
part("forward").addEventListener("click", () => show(at + 1));
part("save").addEventListener("click", save);
part("who").addEventListener("change", keep);
addEventListener("resize", fit);
restore();
if (Object.keys(given).length) part("begin").firstChild.textContent = "Go on ";
show(-1);
