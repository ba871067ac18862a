//! What an entry costs: memory by an allocator that counts, and time.

#![expect(unsafe_code, reason = "a global allocator is unsafe by nature; this one counts and passes on")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::Instant;

thread_local! {
    static LIVE_BYTES: Cell<i64> = const { Cell::new(0) };
    static PEAK_BYTES: Cell<i64> = const { Cell::new(0) };
}

struct Counting;

fn count(bytes: i64) {
    let live = LIVE_BYTES.get() + bytes;
    LIVE_BYTES.set(live);
    PEAK_BYTES.set(PEAK_BYTES.get().max(live));
}

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size() as i64);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(-(layout.size() as i64));
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size as i64 - layout.size() as i64);
        // SAFETY: as the caller promises.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// What a piece of work cost this thread.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Cost {
    /// Most bytes that it had at once, beyond those before it.
    pub(crate) peak_bytes: i64,
    /// Time that passed, s, with whatever else the machine did meanwhile.
    pub(crate) elapsed_s: f64,
}

/// Does something and tells what it cost.
#[expect(clippy::disallowed_methods, reason = "how long a real processor takes is what is measured")]
pub(crate) fn metered(work: impl FnOnce()) -> Cost {
    let before = LIVE_BYTES.get();
    PEAK_BYTES.set(before);
    let began = Instant::now();
    work();
    Cost { peak_bytes: PEAK_BYTES.get() - before, elapsed_s: began.elapsed().as_secs_f64() }
}
