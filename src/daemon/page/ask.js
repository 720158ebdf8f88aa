// Requests to the daemon, and the place where their answers are shown. The other scripts use what is here.
"use strict";

const $ = id => document.getElementById(id);
let status = null, everConnected = false;

// The answer to a request, and its headers. With a body it is a POST, otherwise a GET, unless `method` says something else.
async function askWithHeaders(path, body, withinMs, method) {
  let answer;
  try {
    const options = body === undefined ? {} :
      { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
    if (method) options.method = method;
    if (withinMs) options.signal = AbortSignal.timeout(withinMs);
    answer = await fetch(path, options);
  } catch {
    throw new Error("The daemon does not answer. Check that it runs on this computer.");
  }
  const reply = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new Error([reply.error || `HTTP ${answer.status}`, reply.what_to_do].filter(Boolean).join(". "));
  return { reply, headers: answer.headers };
}

const ask = async (...request) => (await askWithHeaders(...request)).reply;

// The answer to the last press. It has a place of its own, so nothing moves when it comes and goes.
let noticeTimer = 0;
function say(text, mild) {
  const notice = $("notice");
  clearTimeout(noticeTimer);
  notice.textContent = text;
  notice.classList.toggle("mild", !!mild);
  if (text) noticeTimer = setTimeout(() => { notice.textContent = ""; }, mild ? 8000 : 30000);
}
