// Signs this browser in: with the secret of a link, which stands behind the # of the address, or with a token. The cookie of the
// session comes with the answer; its key stays in the storage of this page, where no other page can read it.
"use strict";

const signInState = document.getElementById("sign-in-state");

async function signIn(secret) {
  signInState.textContent = "Signing in.";
  let answer;
  try {
    answer = await fetch("/api/login", { method: "POST", headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ secret }) });
  } catch {
    signInState.textContent = "The daemon does not answer. Check that it runs.";
    return;
  }
  const reply = await answer.json().catch(() => ({}));
  if (answer.ok) {
    localStorage.setItem("key", reply.key);
    location.replace("/");
  } else {
    signInState.textContent = location.hash ?
      "This link was used already, or is older than ten minutes. Get a new one." : `Not signed in: ${reply.error || answer.status}.`;
  }
}

document.getElementById("sign-in-form").addEventListener("submit", event => {
  event.preventDefault();
  history.replaceState(null, "", location.pathname);
  signIn(document.getElementById("sign-in-token").value.trim());
});

async function begin() {
  const secret = location.hash.slice(1);
  if (secret) {
    await signIn(secret);
    return;
  }
  // A link of another page brings no cookie, so this page may be seen although the browser is signed in.
  const answer = await fetch("/api/status").catch(() => null);
  if (answer && answer.ok) location.replace("/");
}

begin();
