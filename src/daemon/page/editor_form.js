// The form of the profile, made from the outline that the daemon gives. A value is written into the text at its place; a
// change of blocks and segments moves lines of the text.
"use strict";

const KEY_WORDS = { to: "To", by: "By", duration: "Duration", mean: "Mean", mean_by: "Mean, from the level before", amplitude: "Amplitude",
  frequency: "Frequency", cycles: "Counted cycles", taper_cycles: "Taper cycles", correct: "Correct amplitude and mean", time: "Times",
  level: "Levels", level_by: "Levels, from the one before", repeat: "Repeat" };
const KEY_UNITS = { n: "N", mm: "mm", s: "s", hz: "Hz" };

function keyWords(key) {
  const [, stem, unit] = /^(.*?)(?:_(n|mm|s|hz))?$/.exec(key);
  return (KEY_WORDS[stem] || stem) + (unit ? `, ${KEY_UNITS[unit]}` : "");
}

// The outline of the text as it is, null while there is none or lines have moved; what the form was made from.
let outline = null, formShape = "";
// A press that came while the places were asked for.
let waiting = null;

const valueOf = (values, key) => values.find(v => v.key === key);
const unquoted = text => { try { return JSON.parse(text); } catch { return text.replace(/^("""|'''|["'])\n?|("""|'''|["'])$/g, ""); } };

// A number, whole number or list as TOML writes it; null if it is none.
function tomlOf(key, text) {
  const typed = text.trim();
  if (/^(time|level)/.test(key)) {
    const list = typed.replace(/^\[|\]$/g, "").split(/[\s,;]+/).filter(Boolean);
    return list.length && list.every(v => isFinite(Number(v))) ? `[${list.map(v => Number(v)).join(", ")}]` : null;
  }
  const plain = typed.replace(",", ".");
  if (!plain || !isFinite(Number(plain))) return null;
  return /^[+-]?(0|[1-9]\d*)(\.\d+)?(e[+-]?\d+)?$/i.test(plain) ? plain : String(Number(plain));
}

function element(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

// A label with its field; `id` is the field's place in the form.
function field(id, words, input) {
  input.id = id;
  return element("div", { className: "field" }, element("label", { htmlFor: id, textContent: words }), input);
}

const formButton = (id, text, title, disabled, action) => {
  const button = element("button", { id, type: "button", className: "small", textContent: text, title, disabled });
  button.setAttribute("aria-label", title);
  button.addEventListener("click", () => { if (outline) action(); else waiting = action; });
  return button;
};

// Writes a value at its place, or as a new line behind the last key; an empty text takes the line out.
function setValue(part, values, key, toml) {
  const there = valueOf(values, key);
  if (there && toml === "") {
    const line = source.value.lastIndexOf("\n", there.from - 1), end = source.value.indexOf("\n", there.to);
    changeLines(source.value.slice(0, Math.max(line, 0)) + (end < 0 ? "" : source.value.slice(end)));
  } else if (there) {
    splice(outline, there.from, there.to, toml);
    there.text = toml;
    there.to = there.from + toml.length;
    textChanged();
  } else if (toml !== "") {
    changeLines(source.value.slice(0, part.keys_at) + `\n${key} = ${toml}` + source.value.slice(part.keys_at));
  }
}

// Lines have moved: the places are asked for again before the next change.
function changeLines(text) {
  source.value = text;
  outline = null;
  showText();
  textChanged(0);
}

const withEnd = text => text.endsWith("\n") ? text : text + "\n";
const cut = (from, to) => changeLines(source.value.slice(0, from) + source.value.slice(to));
const insert = (at, text) => changeLines(withEnd(source.value.slice(0, at)) + text + source.value.slice(at));
// Changes the places of two neighbours.
function swap(a, b) {
  const text = source.value;
  changeLines(text.slice(0, a.from) + withEnd(text.slice(b.from, b.to)) + withEnd(text.slice(a.from, a.to)) + text.slice(b.to));
}

// ---- the form

function headFields() {
  const text = (key, words) => {
    const input = element("input", { autocomplete: "off", maxLength: key === "name" ? 64 : 200 });
    input.addEventListener("input", () => { if (outline) setValue(outline.values[0], outline.values, key, JSON.stringify(input.value)); });
    return field(`form-${key}`, words, input);
  };
  const control = element("select", {}, element("option", { value: "displacement", textContent: "displacement, mm" }),
    element("option", { value: "force", textContent: "force, N" }));
  control.addEventListener("change", () => { if (outline) changeControl(control.value); });
  const fields = [text("name", "Name"), field("form-control", "Control", control)];
  if (valueOf(outline.values, "description")) fields.splice(1, 0, text("description", "Description"));
  return fields;
}

// The keys end in the unit of the controlled quantity. The numbers stay: they are the technician's.
function changeControl(control) {
  const [from, to] = control === "force" ? ["_mm", "_n"] : ["_n", "_mm"];
  const values = outline.blocks.flatMap(b => b.segments.flatMap(s => s.values)).sort((a, b) => b.from - a.from);
  let text = source.value;
  for (const v of values.filter(v => v.key.endsWith(from))) {
    const at = text.lastIndexOf(v.key, v.from - 1);
    text = text.slice(0, at) + v.key.slice(0, -from.length) + to + text.slice(at + v.key.length);
  }
  const there = valueOf(outline.values, "control");
  changeLines(text.slice(0, there.from) + JSON.stringify(control) + text.slice(there.to));
}

function blockForm(b) {
  const block = outline.blocks[b], last = block.segments[block.segments.length - 1];
  const movable = block.segments.every(s => s.has_lines);
  const repeat = element("input", { inputMode: "numeric", autocomplete: "off", placeholder: "1" });
  repeat.addEventListener("input", () => writeTyped(repeat, "repeat", toml => {
    const now = outline.blocks[b];
    setValue(now, now.repeat ? [now.repeat] : [], "repeat", toml);
  }));
  const kind = element("select", {}, ...outline.kinds.map(k => element("option", { value: k.kind, textContent: k.kind })));
  kind.setAttribute("aria-label", `Kind of the new segment of block ${b + 1}`);
  kind.id = `form-${b}-new-kind`;
  const add = formButton(`form-${b}-add`, "Add segment", `Add segment to block ${b + 1}`, !movable, () => {
    const now = outline.blocks[b], end = now.segments.length ? now.segments[now.segments.length - 1].to : now.to;
    insert(end, `\n${outline.kinds.find(k => k.kind === kind.value).template}`);
  });
  const remove = formButton(`form-${b}-remove`, "Remove block", `Remove block ${b + 1}`, !movable, () => cut(outline.blocks[b].from, outline.blocks[b].to));
  return element("fieldset", { className: "block" }, element("legend", { textContent: `Block ${b + 1}` }),
    element("div", { className: "fields" }, field(`form-${b}-repeat`, "Repeat", repeat), remove),
    ...block.segments.map((_, s) => segmentForm(b, s)),
    element("div", { className: "fields" }, kind, add),
    ...(movable || !last ? [] : [element("p", { className: "hint", textContent: "These segments stand in one line each: add and move them in the text." })]));
}

// Writes what was typed if it is a value; marks the field otherwise.
function writeTyped(input, key, then) {
  const toml = input.value.trim() === "" && input.placeholder ? "" : tomlOf(key, input.value);
  input.setAttribute("aria-invalid", String(toml === null));
  if (toml !== null && outline) then(toml);
}

function segmentForm(b, s) {
  const now = () => outline.blocks[b].segments[s], segment = now(), id = `form-${b}-${s}`, called = `segment ${b + 1}.${s + 1}`;
  const kind = unquoted((valueOf(segment.values, "kind") || { text: '""' }).text), known = outline.kinds.find(k => k.kind === kind);
  const select = element("select", {}, ...outline.kinds.map(k => element("option", { value: k.kind, textContent: k.kind })));
  select.value = kind;
  select.addEventListener("change", () => {
    if (!outline) return;
    const text = source.value.slice(now().from, now().to), head = text.indexOf("[[block.segment]]");
    changeLines(source.value.slice(0, now().from) + text.slice(0, head) + outline.kinds.find(k => k.kind === select.value).template +
      "\n" + source.value.slice(now().to));
  });
  select.disabled = !segment.has_lines;
  const keys = (known ? known.keys : []).map(k => keyField(`${id}-${k.key}`, k, now));
  const count = outline.blocks[b].segments.length;
  const up = formButton(`${id}-up`, "Up", `Move ${called} up`, !segment.has_lines || s === 0, () => swap(outline.blocks[b].segments[s - 1], now()));
  const down = formButton(`${id}-down`, "Down", `Move ${called} down`, !segment.has_lines || s === count - 1, () => swap(now(), outline.blocks[b].segments[s + 1]));
  const remove = formButton(`${id}-remove`, "Remove", `Remove ${called}`, !segment.has_lines, () => cut(now().from, now().to));
  return element("fieldset", { className: "segment" }, element("legend", { textContent: `Segment ${b + 1}.${s + 1}` }),
    element("div", { className: "fields" }, field(`${id}-kind`, "Kind", select), ...keys),
    element("div", { className: "fields" }, up, down, remove));
}

function keyField(id, k, now) {
  const written = () => now().values.find(v => v.key === k.key || (k.or && v.key === k.or));
  const key = () => (written() || k).key;
  if (k.key === "correct") {
    const box = element("input", { type: "checkbox" });
    box.addEventListener("change", () => { if (outline) setValue(now(), now().values, "correct", String(box.checked)); });
    return field(id, keyWords(k.key), box);
  }
  const input = element("input", { inputMode: "decimal", autocomplete: "off", placeholder: k.default });
  input.addEventListener("input", () => writeTyped(input, k.key, toml => setValue(now(), now().values, key(), toml)));
  return field(id, keyWords(key()), input);
}

// Makes the form new where blocks, segments or keys have changed; otherwise only writes values where nobody types.
function showForm() {
  if (!outline) return;
  const shape = JSON.stringify([outline.values.map(v => v.key), outline.unit, outline.blocks.map(b => [!!b.repeat, b.segments.map(s => [s.has_lines,
    s.values.map(v => v.key === "kind" ? v.text : v.key).sort()])])]);
  if (shape !== formShape) {
    formShape = shape;
    const focus = document.activeElement && $("editor-form").contains(document.activeElement) ? document.activeElement : null;
    const at = focus && focus.selectionStart !== undefined ? focus.selectionStart : null;
    const add = formButton("form-add-block", "Add block", "Add block", false, () =>
      insert(source.value.length, `\n[[block]]\nrepeat = 1\n\n${outline.kinds[0].template}`));
    $("editor-form").replaceChildren(element("div", { className: "fields" }, ...headFields()), ...outline.blocks.map((_, b) => blockForm(b)), add);
    fillForm();
    const again = focus && $(focus.id);
    if (again) { again.focus(); if (at !== null && again.setSelectionRange) again.setSelectionRange(at, at); }
  } else fillForm();
  const pressed = waiting;
  waiting = null;
  if (pressed) pressed();
}

function fillForm() {
  const fill = (id, value) => {
    const input = $(id);
    if (!input || input === document.activeElement && input.value !== "" && input.type !== "checkbox") return;
    if (input.type === "checkbox") input.checked = value !== "false"; else input.value = value;
  };
  for (const v of outline.values) fill(`form-${v.key}`, unquoted(v.text));
  outline.blocks.forEach((block, b) => {
    fill(`form-${b}-repeat`, block.repeat ? block.repeat.text : "");
    block.segments.forEach((segment, s) => {
      const kind = outline.kinds.find(k => k.kind === unquoted((valueOf(segment.values, "kind") || { text: '""' }).text));
      for (const k of kind ? kind.keys : []) {
        const v = segment.values.find(v => v.key === k.key || (k.or && v.key === k.or));
        fill(`form-${b}-${s}-${k.key}`, v ? v.text : "");
      }
    });
  });
}
