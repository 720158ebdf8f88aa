// Requests to the daemon, and the place where their answers are shown. The other scripts use what is here.
"use strict";

const $ = id => document.getElementById(id);
let status = null, everConnected = false;

// The answer to a request, and its headers. With a body it is a POST, otherwise a GET. more: method, signal (ends the request), take_over
// (of the command), bytes (a body that is no JSON).
async function askWithHeaders(path, body, withinMs, more = {}) {
  let answer;
  try {
    const options = { method: more.method || (body === undefined && !more.bytes ? "GET" : "POST") };
    if (options.method !== "GET") {
      options.headers = { "Content-Type": more.bytes ? "application/octet-stream" : "application/json",
        "leafbench-caller": callerHeader(more.take_over) };
      // The cookie watches and stops; orders show the key that only this page can read.
      const key = localStorage.getItem("key");
      if (key) options.headers.Authorization = `Bearer ${key}`;
      options.body = more.bytes || (body === undefined ? undefined : JSON.stringify(body));
    }
    options.signal = withinMs ? AbortSignal.timeout(withinMs) : more.signal;
    answer = await fetch(path, options);
  } catch (error) {
    if (more.signal && more.signal.aborted) throw error;
    throw new Error("The daemon does not answer. Check that it runs on this computer.");
  }
  const reply = await answer.json().catch(() => ({}));
  if (!answer.ok) {
    const text = [reply.error || `HTTP ${answer.status}`, reply.what_to_do].filter(Boolean).map(sentence).join(" ");
    throw Object.assign(new Error(text), { status: answer.status, place: reply.place });
  }
  return { reply, headers: answer.headers };
}

const ask = async (...request) => (await askWithHeaders(...request)).reply;

// Asks a question in its place on the page, which never stands between a person and Stop. `yes` is the word of the button.
function inquire(id, question, yes, action) {
  const place = $(id);
  const button = (text, then) => {
    const b = Object.assign(document.createElement("button"), { type: "button", className: "small", textContent: text });
    b.addEventListener("click", () => { place.hidden = true; place.replaceChildren(); then(); });
    return b;
  };
  const words = Object.assign(document.createElement("span"), { textContent: question });
  const answer = button(yes, action);
  place.replaceChildren(words, " ", answer, " ", button("No", () => {}));
  place.hidden = false;
  answer.focus();
}

// The answer to the last press. It has a place of its own, so nothing moves when it comes and goes.
let noticeTimer = 0;
function say(text, mild) {
  const notice = $("notice");
  clearTimeout(noticeTimer);
  notice.textContent = text;
  notice.classList.toggle("mild", !!mild);
  if (text) noticeTimer = setTimeout(() => { notice.textContent = ""; }, mild ? 8000 : 30000);
}
