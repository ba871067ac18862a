//! An allocator that counts what each thread has; a binary that wants to know declares it its own:
//! `#[global_allocator] static ALLOCATOR: Counting = Counting;`. A piece of work that takes more than it may ends the program.

#![expect(unsafe_code, reason = "a global allocator is unsafe by nature; this one counts and passes on")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::io::Write;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
    static LIVE_BYTES: Cell<i64> = const { Cell::new(0) };
    static PEAK_BYTES: Cell<i64> = const { Cell::new(0) };
    /// As many live bytes are too many.
    static LIMIT_BYTES: Cell<i64> = const { Cell::new(i64::MAX) };
}

/// The system's allocator, counted.
pub struct Counting;

/// Allocations of this thread so far.
pub fn allocations() -> u64 {
    ALLOCATIONS.get()
}

/// Bytes that this thread has taken and not given back.
pub fn live_bytes() -> i64 {
    LIVE_BYTES.get()
}

/// Most bytes that a piece of work has at once, beyond those before it.
pub fn peak_bytes(work: impl FnOnce()) -> i64 {
    let before = LIVE_BYTES.get();
    PEAK_BYTES.set(before);
    work();
    PEAK_BYTES.get() - before
}

/// Does a piece of work that may have so many bytes at once, beyond those before it; with more, the program aborts and says where.
pub fn within<T>(bytes: i64, work: impl FnOnce() -> T) -> T {
    LIMIT_BYTES.set(LIVE_BYTES.get() + bytes);
    let done = work();
    LIMIT_BYTES.set(i64::MAX);
    done
}

#[cold]
fn too_much(live: i64) -> ! {
    // To say so takes memory, too.
    LIMIT_BYTES.set(i64::MAX);
    let at = std::backtrace::Backtrace::force_capture();
    let _ = writeln!(std::io::stderr(), "{live} bytes at once are more than this may take, at\n{at}");
    std::process::abort()
}

fn count(allocations: u64, bytes: i64) {
    ALLOCATIONS.set(ALLOCATIONS.get() + allocations);
    let live = LIVE_BYTES.get() + bytes;
    LIVE_BYTES.set(live);
    PEAK_BYTES.set(PEAK_BYTES.get().max(live));
    if live > LIMIT_BYTES.get() {
        too_much(live);
    }
}

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(1, layout.size() as i64);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(0, -(layout.size() as i64));
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(1, size as i64 - layout.size() as i64);
        // SAFETY: as the caller promises.
        unsafe { System.realloc(pointer, layout, size) }
    }
}
