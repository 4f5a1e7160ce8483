"use strict";
const content = JSON.parse(document.getElementById("content").textContent);
const place = "nrbench-labels-" + content.sheet;
const part = (id) => document.getElementById(id);
const choices = [...document.querySelectorAll("button.answer")];
let given = {};
let at = -1;
let since = 0;

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
  const open = content.items.findIndex(([id]) => !(id in given));
  return open < 0 ? content.items.length : open;
}
function picture(image, index) {
  image.src = "data:image/png;base64," + content.pictures[index];
  return image.decode();
}
function fit() {
  const images = [part("sample"), part("output")];
  const width = images.reduce((sum, image) => sum + image.naturalWidth, 0);
  const height = Math.max(...images.map((image) => image.naturalHeight));
  if (!width) return;
  const room = Math.min((innerWidth - 80) / width, (innerHeight - 250) / height);
  const scale = room >= 1 ? Math.min(4, Math.floor(room)) : Math.max(0.25, room);
  for (const image of images) {
    image.width = Math.round(image.naturalWidth * scale);
    image.height = Math.round(image.naturalHeight * scale);
  }
}
async function show(index) {
  at = index;
  const last = content.items.length;
  const done = Object.keys(given).length;
  part("start").hidden = at >= 0;
  part("work").hidden = at < 0 || at >= last;
  part("end").hidden = at < last;
  part("bar").value = done / last;
  part("count").textContent = at >= 0 && at < last ? `${at + 1} of ${last}, ${done} answered` : `${done} of ${last} answered`;
  part("save").disabled = done === 0;
  if (at < 0 || at >= last) return;
  const [id, sample, output] = content.items[at];
  for (const choice of choices) {
    choice.setAttribute("aria-pressed", String(id in given && given[id].answer === choice.dataset.answer));
  }
  part("back").disabled = at === 0;
  part("forward").disabled = !(id in given);
  since = Infinity;
  await Promise.all([picture(part("sample"), sample), picture(part("output"), output)]);
  if (at !== index) return;
  fit();
  since = performance.now();
}
function answer(word) {
  if (since === Infinity) return;
  given[content.items[at][0]] = { answer: word, seconds: (performance.now() - since) / 1000 };
  keep();
  show(at + 1);
}
function table() {
  const rows = content.items.flatMap(([id], i) => {
    const one = given[id];
    return one ? [[id, one.answer, one.seconds.toFixed(2), i + 1].join(",")] : [];
  });
  return ["item,answer,seconds,order", ...rows, ""].join("\r\n");
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
  const last = content.items.length;
  if (number >= 0 && at < last) answer(content.answers[number]);
  else if (event.key === "ArrowLeft" && at > 0) show(at - 1);
  else if (event.key === "ArrowRight" && at < last && content.items[at][0] in given) show(at + 1);
  else return;
  event.preventDefault();
});
for (const choice of choices) choice.addEventListener("click", () => answer(choice.dataset.answer));
part("begin").addEventListener("click", () => show(first()));
part("back").addEventListener("click", () => show(at - 1));
part("forward").addEventListener("click", () => show(at + 1));
part("save").addEventListener("click", save);
part("who").addEventListener("change", keep);
addEventListener("resize", fit);
restore();
if (Object.keys(given).length) part("begin").firstChild.textContent = "Go on ";
show(-1);
