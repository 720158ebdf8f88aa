// The text of the profile: line numbers, the place of an error, changes at a place. The text is the profile; the form only
// shows it and writes into it.
"use strict";

const source = $("editor-source");
let errorPlace = null;

// Offset in the text of a line and a column in characters, both from 1.
function offsetOf(text, { line, column }) {
  const lines = text.split("\n");
  const before = lines.slice(0, line - 1).reduce((sum, l) => sum + l.length + 1, 0);
  return before + [...(lines[line - 1] || "")].slice(0, column - 1).join("").length;
}

// What is wrong at an offset: the word there, or one character.
const wordAt = (text, offset) => (/^("[^"\n]*"|\[\[?[^\]\n]*\]\]?|[^\s,\]}]+)/.exec(text.slice(offset)) || [text[offset] || " "])[0].length;

function showText() {
  const text = source.value, lines = text.split("\n").length;
  const numbers = Array.from({ length: lines }, (_, i) => {
    const wrong = errorPlace && errorPlace.line === i + 1;
    return Object.assign(document.createElement(wrong ? "b" : "span"), { textContent: `${i + 1}\n` });
  });
  $("editor-lines").replaceChildren(...numbers);
  const marks = $("editor-marks");
  if (!errorPlace) marks.replaceChildren(text + "\n");
  else {
    const from = offsetOf(text, errorPlace), to = from + wordAt(text, from);
    const mark = Object.assign(document.createElement("mark"), { textContent: text.slice(from, to) || " " });
    marks.replaceChildren(text.slice(0, from), mark, text.slice(to) + "\n");
  }
  scrollAlong();
}

function showError(error) {
  errorPlace = (error && error.place) || null;
  $("editor-error").textContent = error ? error.message : "";
  source.setAttribute("aria-invalid", String(!!error));
  $("editor-goto").hidden = !errorPlace;
  showText();
}

function scrollAlong() {
  $("editor-lines").scrollTop = source.scrollTop;
  $("editor-marks").scrollTop = source.scrollTop;
  $("editor-marks").scrollLeft = source.scrollLeft;
}

$("editor-goto").addEventListener("click", () => {
  const from = offsetOf(source.value, errorPlace);
  source.focus();
  source.setSelectionRange(from, from + wordAt(source.value, from));
  source.scrollTop = Math.max(0, (errorPlace.line - 5) * parseFloat(getComputedStyle(source).lineHeight));
});
source.addEventListener("scroll", scrollAlong);

// Replaces a part of the text and moves the places of the outline that lie behind it.
function splice(outline, from, to, text) {
  source.value = source.value.slice(0, from) + text + source.value.slice(to);
  const by = text.length - (to - from);
  const shift = part => {
    for (const key of ["from", "to", "keys_at"]) if (typeof part[key] === "number" && part[key] >= to && !(key === "from" && part[key] === from)) part[key] += by;
    for (const value of Object.values(part)) if (value && typeof value === "object") shift(value);
  };
  shift(outline);
  showText();
}
