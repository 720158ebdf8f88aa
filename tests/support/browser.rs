//! A headless Chromium with one page, driven over its debugging socket: keys, mouse, what the page shows.

use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::process::{Command, Stdio};

use serde_json::{Value, json};
use tungstenite::{Message, WebSocket};

use super::{PATIENCE, Process, until};

/// The names under which the program is installed.
const PROGRAMS: [&str; 2] = ["chromium", "chromium-browser"];
/// With this variable the tests of the page fail without Chromium, instead of passing without running.
const REQUIRED: &str = "LEAFBENCH_REQUIRE_CHROMIUM";

/// One page in a browser of its own.
pub struct Page {
    socket: WebSocket<TcpStream>,
    asked: u64,
    _process: Process,
    _folder: tempfile::TempDir,
}

impl Page {
    /// Opens `url` in a window of this size. `None` if there is no Chromium.
    pub fn open(url: &str, width: u32, height: u32) -> Option<Page> {
        let folder = tempfile::tempdir().expect("a folder");
        let Some((process, debugger)) = PROGRAMS.iter().find_map(|name| start(name, folder.path())) else {
            assert!(std::env::var_os(REQUIRED).is_none(), "Chromium is not installed");
            println!("SKIPPED: Chromium is not installed");
            return None;
        };
        let address = page_address(&debugger);
        let stream = TcpStream::connect(&debugger).expect("the browser listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("set");
        let (socket, _) = tungstenite::client(address, stream).expect("upgraded");
        let mut page = Page {
            socket,
            asked: 0,
            _process: process,
            _folder: folder,
        };
        page.size(width, height);
        // A window that nobody looks at would have no focus.
        page.ask("Emulation.setFocusEmulationEnabled", &json!({ "enabled": true }));
        page.ask("Page.navigate", &json!({ "url": url }));
        Some(page)
    }

    /// Gives the window another size.
    pub fn size(&mut self, width: u32, height: u32) {
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            &json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false }),
        );
    }

    /// Sends a command of the DevTools protocol and waits for its answer.
    pub fn ask(&mut self, method: &str, parameters: &Value) -> Value {
        let answer = self.answer(method, parameters);
        assert!(answer["error"].is_null(), "{method}: {answer}");
        answer["result"].clone()
    }

    /// The same with the error, if there is one.
    fn answer(&mut self, method: &str, parameters: &Value) -> Value {
        self.asked += 1;
        let text = json!({ "id": self.asked, "method": method, "params": parameters }).to_string();
        self.socket.send(Message::Text(text.into())).expect("sent");
        loop {
            let Message::Text(text) = self.socket.read().expect("an answer") else {
                continue;
            };
            let answer: Value = serde_json::from_str(&text).expect("JSON");
            if answer["id"] == self.asked {
                return answer;
            }
        }
    }

    /// The value of an expression in the page.
    pub fn value(&mut self, expression: &str) -> Value {
        let parameters = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let answer = self.ask("Runtime.evaluate", &parameters);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true; also while the window goes on to another page, as after a link that signs in.
    pub fn until(&mut self, expression: &str) {
        let parameters =
            json!({ "expression": format!("!!({expression})"), "awaitPromise": true, "returnByValue": true });
        until(expression, || {
            let answer = self.answer("Runtime.evaluate", &parameters);
            let result = &answer["result"];
            let goes_on = answer["error"]["message"]
                .as_str()
                .is_some_and(|text| text.contains("navigated") || text.contains("context"));
            assert!(goes_on || answer["error"].is_null(), "{expression}: {answer}");
            assert!(result["exceptionDetails"].is_null(), "{expression}: {answer}");
            (result["result"]["value"] == true).then_some(())
        });
    }

    /// Waits until the page names this state.
    pub fn until_state(&mut self, state: &str) {
        self.until(&format!(
            "document.getElementById('state') && document.getElementById('state').textContent === '{state}'"
        ));
    }

    /// Text of an element as it is shown.
    pub fn text(&mut self, id: &str) -> String {
        let text = self.value(&format!("document.getElementById('{id}').innerText"));
        text.as_str().expect("a text").to_owned()
    }

    /// Presses and releases a key; `text` is what it would write.
    pub fn key(&mut self, key: &str, text: &str) {
        for (kind, text) in [("keyDown", text), ("keyUp", "")] {
            let event = json!({ "type": kind, "key": key, "code": key, "text": text });
            self.ask("Input.dispatchKeyEvent", &event);
        }
    }

    /// The mouse on the middle of an element: `mousePressed` or `mouseReleased`.
    pub fn mouse(&mut self, kind: &str, id: &str) {
        let middle = self.value(&format!(
            "(() => {{ const r = document.getElementById('{id}').getBoundingClientRect(); \
             return [r.x + r.width / 2, r.y + r.height / 2]; }})()"
        ));
        let event =
            json!({ "type": kind, "x": middle[0], "y": middle[1], "button": "left", "clickCount": 1 });
        self.ask("Input.dispatchMouseEvent", &event);
    }

    /// Presses and releases the mouse on an element.
    pub fn click(&mut self, id: &str) {
        self.mouse("mousePressed", id);
        self.mouse("mouseReleased", id);
    }

    /// What the window shows, as a PNG file.
    pub fn screenshot(&mut self, file: &std::path::Path) {
        let answer = self.ask("Page.captureScreenshot", &json!({ "format": "png" }));
        let data = answer["data"].as_str().expect("an image");
        let image = data_encoding::BASE64.decode(data.as_bytes()).expect("base64");
        std::fs::write(file, image).expect("written");
    }

    /// Shows the page as a computer with this theme does: `light` or `dark`.
    pub fn theme(&mut self, theme: &str) {
        let features = json!([{ "name": "prefers-color-scheme", "value": theme }]);
        self.ask("Emulation.setEmulatedMedia", &json!({ "features": features }));
    }

    /// Everything that is cut off, lies outside of the window, or lies over something else that can be pressed.
    pub fn misplaced(&mut self) -> String {
        let found = self.value(MISPLACED);
        found.as_str().expect("a text").to_owned()
    }
}

/// Texts that are longer than their place, a page wider than its window, buttons that lie over each other.
const MISPLACED: &str = "(() => {
  const found = [], shown = e => e.offsetParent !== null || getComputedStyle(e).position === 'fixed';
  for (const e of document.querySelectorAll('button, strong, dd, dt, p, figcaption, th, label, li, #state-detail, #notice, .clear'))
    if (shown(e) && e.clientWidth && e.scrollWidth > e.clientWidth + 1) found.push(`cut: ${e.id || e.textContent}`);
  if (document.documentElement.scrollWidth > innerWidth) found.push(`the page is ${document.documentElement.scrollWidth} wide`);
  // What a list has scrolled out of sight lies over nothing.
  const inSight = e => { const box = e.closest('.scroll'); if (!box) return true;
    const [r, b] = [e.getBoundingClientRect(), box.getBoundingClientRect()]; return r.bottom <= b.bottom + 1 && r.top >= b.top - 1; };
  const main = [...document.querySelectorAll('main button, main input, main select, main a')].filter(e => shown(e) && inSight(e));
  const head = [...document.querySelectorAll('header button, header output, header strong')].filter(shown);
  for (const group of [main, head]) for (const a of group) for (const b of group) if (a !== b) {
    const [p, q] = [a.getBoundingClientRect(), b.getBoundingClientRect()];
    if (p.left < q.right - 1 && q.left < p.right - 1 && p.top < q.bottom - 1 && q.top < p.bottom - 1)
      found.push(`${a.id || a.textContent} lies over ${b.id || b.textContent}`);
  }
  return found.join('; ');
})()";

/// Starts a browser; its process, and host and port of its debugger.
fn start(program: &str, folder: &std::path::Path) -> Option<(Process, String)> {
    let mut child = Command::new(program)
        .args([
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--remote-debugging-port=0",
        ])
        .arg(format!("--user-data-dir={}", folder.display()))
        .arg("about:blank")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .ok()?;
    let told = BufReader::new(child.stderr.take().expect("piped"));
    let process = Process(child);
    let mut lines = told.lines().map_while(Result::ok);
    let line = lines
        .find(|line| line.contains("DevTools listening on ws://"))
        .expect("the browser says where it listens");
    let address = line.split("ws://").nth(1).and_then(|rest| rest.split('/').next());
    let address = address.expect("an address").to_owned();
    // A pipe that nobody reads would stop the browser.
    std::thread::spawn(move || lines.for_each(drop));
    Some((process, address))
}

/// Address of the debugger of the first page.
fn page_address(debugger: &str) -> String {
    until("a page in the browser", || {
        let list: Vec<Value> = ureq::get(format!("http://{debugger}/json/list"))
            .config()
            .proxy(None)
            .build()
            .call()
            .ok()?
            .body_mut()
            .read_json()
            .ok()?;
        let page = list.iter().find(|target| target["type"] == "page")?;
        page["webSocketDebuggerUrl"].as_str().map(str::to_owned)
    })
}
