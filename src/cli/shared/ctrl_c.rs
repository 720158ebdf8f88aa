//! Ctrl-C as a value to look at, instead of the end of the process.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// Becomes true at Ctrl-C.
pub(crate) fn ctrl_c_flag() -> Arc<AtomicBool> {
    let flag = Arc::new(AtomicBool::new(false));
    let pressed = Arc::clone(&flag);
    listen(move || pressed.store(true, Ordering::Relaxed));
    flag
}

/// Counts how often Ctrl-C was pressed.
pub(crate) fn ctrl_c_count() -> Arc<AtomicU32> {
    let count = Arc::new(AtomicU32::new(0));
    let pressed = Arc::clone(&count);
    listen(move || {
        pressed.fetch_add(1, Ordering::Relaxed);
    });
    count
}

/// Calls `pressed` at every Ctrl-C. Where no thread or no signal handler can be had, Ctrl-C ends the process as usual.
fn listen(pressed: impl Fn() + Send + 'static) {
    let wait_for_signals = move || {
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_io().build() else {
            return;
        };
        runtime.block_on(async {
            while tokio::signal::ctrl_c().await.is_ok() {
                pressed();
            }
        });
    };
    let _ = std::thread::Builder::new()
        .name("ctrl-c".to_owned())
        .spawn(wait_for_signals);
}
