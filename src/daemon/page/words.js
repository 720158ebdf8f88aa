// The words of the page: what each state means and what to do, and how numbers are written.
"use strict";

// State: its name, what is the case and what to do, whether something moves or may move.
const PHASES = {
  connecting: ["No rig", "The rig does not answer. Check its power and the link. Nobody can see from here whether it moves.", true],
  ready: ["Ready", "The rig is unloaded and the pressure is off. You can start a run.", false],
  arming: ["Arming", "The pressure is being switched on. Then the rig moves.", true],
  running: ["Running", "The rig moves.", true],
  held: ["On hold", "The rig keeps its position with the pressure on. Press Resume or Stop.", true],
  unloading: ["Unloading", "The rig unloads by itself.", true],
  interlocked: ["Interlocked", "", false],
};
const PREPARING = ["Preparing", "The profile is being checked. Then the rig moves. Stop withdraws the run.", true];
const MOTIONS = {
  zero: ["To zero", "The rig returns slowly to the tared zero, then it unloads.", true],
  jog: ["Jogging", "The rig moves while you hold the button.", true],
};
const JOG_KEEPS = ["Jog ended", "The rig keeps its position with the pressure on. Jog again, or press Stop to unload now.", true];
const NO_DAEMON = ["No daemon", "The connection to the daemon is lost. If the daemon has ended, the rig unloads by itself.", true];
const CONNECTING = ["Connecting", "Waiting for the daemon.", true];

// Cause of a trip: what happened, what to do. The codes are those of docs/faults.md.
const CAUSES = {
  lease_lapsed: ["The rig did not hear the daemon for the time of its lease.", "Check the cable and the load of this computer."],
  host_abort: ["The motion was aborted.", "Read the reason here, and remove it."],
  requested: ["The rig was asked to unload.", "Nothing is wrong."],
  force_limit: ["The force passed its limit.", "Check profile, specimen and the zero of the load cell."],
  displacement_limit: ["The displacement passed its limit.", "Check the profile and the zero of the LVDT; bring the piston back within the limit."],
  velocity_limit: ["The speed passed its limit.", "Check the profile and the servo valve."],
  following_error: ["The rig did not follow the command.", "Check valve and pressure; lower frequency or amplitude."],
  queue_dry: ["The commands of this computer came too late.", "End other programs on this computer."],
  corrupt_frames: ["Three damaged frames came within 0.1 s.", "Check cable, shield and termination."],
  force_sensor: ["The load cell gave no reading.", "Check the load cell and its cable."],
  displacement_sensor: ["The LVDT gave no reading.", "Check the LVDT and its cable."],
  sensor_stuck: ["The LVDT did not move with the piston.", "Check the LVDT and its rod."],
  specimen_break: ["The force fell by more than half within 10 ms.", "Look at the specimen."],
  watchdog: ["The firmware of the rig stood still.", "Note what was done, and tell who maintains the firmware."],
  hold_timeout: ["The hold lasted too long, so the rig unloaded.", "Start again."],
  emergency_stop: ["The emergency stop was pressed.", "Remove the danger, then release the button."],
  supply_pressure: ["The supply pressure was too low.", "Check pump and hoses."],
  foreign_session: ["Another program sent commands to this rig.", "End the other program."],
  bad_command: ["A command was beyond the limits.", "Check that daemon and firmware have the same version."],
};

const number = (value, digits) => value === null || value === undefined ? "\u2013" :
  value.toFixed(digits).replace(/^-(?=0(\.0*)?$)/, "").replace("-", "\u2212");

function duration(seconds) {
  const s = Math.max(0, Math.round(seconds)), minutes = Math.floor(s / 60);
  if (minutes >= 60) return `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
  return minutes ? `${minutes} min ${String(s % 60).padStart(2, "0")} s` : `${s} s`;
}

// A first word that is a name, as of a file or a key, keeps its small letter.
const sentence = text => text ? (/^\S*[._\d]/.test(text) ? text[0] : text[0].toUpperCase()) + text.slice(1) + (/[.!?]$/.test(text) ? "" : ".") : "";

// The cause of an ending without the word for the ending, which stands before it: "stopped" and "stopped by an operator".
const withoutWord = (cause, ending) => ending && cause.startsWith(ending + " ") ? cause.slice(ending.length + 1) : cause;

// What the bench does, in words: [name, detail, keep clear].
function phaseWords(status, everConnected) {
  const rig = status && status.rig;
  if (!rig) return everConnected ? NO_DAEMON : CONNECTING;
  if (status.preparing && rig.phase === "ready") return PREPARING;
  if (rig.motion && rig.phase === "running") {
    return rig.motion === "jog" && rig.hold_left_s !== null ? JOG_KEEPS : MOTIONS[rig.motion];
  }
  const [name, detail, clear] = PHASES[rig.phase];
  if (rig.phase === "interlocked") return [name, trip(rig), clear];
  const notice = rig.notice && rig.phase !== "running" ? sentence(rig.notice) : "";
  if (rig.phase === "connecting" || rig.phase === "arming") return [name, [detail, notice].filter(Boolean).join(" "), clear];
  if (rig.phase === "ready") return [name, [rig.off_zero || detail, notice].filter(Boolean).join(" "), clear];
  return [name, [notice, detail].filter(Boolean).join(" "), clear];
}

// After a trip: what happened, what to do.
function trip(rig) {
  const [happened, remedy] = CAUSES[rig.cause] || ["", "Remove the cause."];
  const told = [rig.fault, rig.notice].filter((text, i, all) => text && all.indexOf(text) === i).map(sentence);
  return `What happened: ${[happened, ...told].filter(Boolean).join(" ") || "The bench is latched."}\n` +
    `What to do: ${remedy} Then press Reset, which moves nothing.${rig.off_zero ? " Then return to zero." : ""}`;
}
