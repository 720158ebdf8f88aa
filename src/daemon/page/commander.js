// Who commands: this page names itself with every order, shows who has the command, and asks before it takes the command over.
"use strict";

// A page that is loaded again is the same client. While it is open the id is not in the storage, which a copied tab takes along.
const callerId = sessionStorage.getItem("caller") || crypto.randomUUID();
sessionStorage.removeItem("caller");
window.addEventListener("pagehide", () => sessionStorage.setItem("caller", callerId));
window.addEventListener("pageshow", () => sessionStorage.removeItem("caller"));

// A header carries ASCII only.
const ascii = text => text.replace(/[^\x20-\x7e]/g, c => `\\u${c.charCodeAt(0).toString(16).padStart(4, "0")}`);

function callerHeader(take_over) {
  const operator = $("operator").value.trim().slice(0, 80);
  const name = operator ? `the page of ${operator}` : "a page without an operator's name";
  return ascii(JSON.stringify({ id: callerId, name, stays: true, take_over: !!take_over }));
}

const commander = () => status && status.commander;
const isMine = () => !!commander() && commander().id === callerId;
// Another client commands: this page watches. Stop is for everyone.
const isWatching = () => !!commander() && !isMine();

function showCommander() {
  const who = commander();
  document.body.classList.toggle("watching", isWatching());
  for (const button of document.querySelectorAll("button[data-order]")) button.disabled = isWatching();
  const since = who ? new Date(who.since_utc).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" }) : "";
  write("commander", !status ? "" : !who ? "Nobody commands the bench. The first order takes the command." :
    `${isMine() ? "" : "Watching. "}Commanded by: ${who.name}${isMine() ? " (this page)" : ""}, since ${since}.`);
  $("take-over").hidden = !isWatching() || !$("take-over-ask").hidden;
  if (!isWatching()) $("take-over-ask").hidden = true;
}

$("take-over").addEventListener("click", () => {
  inquire("take-over-ask", `Take over control from ${commander().name}?`, "Take over", async () => {
    try { await ask("api/command", {}, 0, { take_over: true }); } catch (error) { say(error.message); }
  });
  showCommander();
});
