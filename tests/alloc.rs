//! No allocation per frame in the warmed pipeline, by a counting allocator.

#![expect(unsafe_code, reason = "a global allocator is unsafe by nature; this one counts and passes on")]

mod rig;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicU64, Ordering};

use posed::input::{Entry, Input};
use posed::output::Output;
use posed::pipeline::Pipeline;
use posed_simulator::scenario::{DeviceScenario, Scenario};
use rig::{Rig, stage};

struct Counting;

static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

// SAFETY: every call is passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_warm_pipeline_does_not_allocate() {
    let stage_file = stage(&[2, 1]);
    let flock =
        |name: &str, burst_ms| DeviceScenario { name: name.into(), burst_ms, ..DeviceScenario::default() };
    let scenario = Scenario { devices: vec![flock("d0", 16.0), flock("d1", 0.0)], ..Scenario::default() };
    let mut rig = Rig::new(&stage_file, &scenario);
    rig.run_until(12.0);

    let mut pipeline = Pipeline::new(&stage_file).unwrap();
    let warm = rig.log.partition_point(|entry| entry.t.as_secs_f64() < 6.0);
    let mut frames = 0;
    let mut feed = |pipeline: &mut Pipeline, log: &[Entry]| {
        for entry in log {
            pipeline.push(entry, &mut |output| frames += u64::from(matches!(output, Output::Estimate(_))));
        }
    };
    feed(&mut pipeline, &rig.log[..warm]);
    let bytes = rig.log[warm..].iter().filter(|entry| matches!(entry.input, Input::Bytes { .. })).count();
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    feed(&mut pipeline, &rig.log[warm..]);
    let allocations = ALLOCATIONS.load(Ordering::Relaxed) - before;
    assert!(frames > 500 && bytes > 500, "{frames} frames from {bytes} chunks");
    assert_eq!(allocations, 0, "in {frames} frames");
}
