// Hold-to-move: small steps are asked for while the button is held. A step ends by itself, so the rig also stops if this page,
// its tab or the connection is gone.
"use strict";

const JOG_STEP_MM = 0.1, JOG_PERIOD_MS = 100, JOG_ANSWER_MS = 500;
let jogDirection = 0, jogAtWork = false;

const pause = ms => new Promise(done => setTimeout(done, ms));

async function jogWhileHeld(direction) {
  if (jogAtWork) return;
  jogAtWork = true;
  jogDirection = direction;
  let goes_on = false;
  try {
    while (jogDirection === direction && document.hasFocus() && !document.hidden && status) {
      await ask("api/jog", { step_mm: direction * JOG_STEP_MM, goes_on }, JOG_ANSWER_MS);
      // After a stop the button must be pressed again.
      goes_on = true;
      await pause(JOG_PERIOD_MS);
    }
    await ask("api/jog", { step_mm: 0 }, JOG_ANSWER_MS);
  } catch (error) {
    say(error.message);
    await ask("api/jog", { step_mm: 0 }, JOG_ANSWER_MS).catch(() => {});
  }
  jogDirection = 0;
  jogAtWork = false;
}

function jogEnd() { jogDirection = 0; }

function jogButton(id, direction) {
  const button = $(id);
  button.addEventListener("pointerdown", event => { if (event.button === 0 && !button.disabled) jogWhileHeld(direction); });
  for (const end of ["pointerup", "pointercancel", "pointerleave", "blur"]) button.addEventListener(end, jogEnd);
  button.addEventListener("contextmenu", event => event.preventDefault());
  button.addEventListener("keydown", event => {
    if (event.key !== "Enter") return;
    event.preventDefault();
    if (!event.repeat && !button.disabled) jogWhileHeld(direction);
  });
  button.addEventListener("keyup", jogEnd);
}

jogButton("jog-up", 1);
jogButton("jog-down", -1);
window.addEventListener("blur", jogEnd);
window.addEventListener("pagehide", jogEnd);
window.addEventListener("pointerup", jogEnd);
document.addEventListener("visibilitychange", jogEnd);
