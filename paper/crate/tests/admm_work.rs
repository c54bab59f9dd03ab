//! What an iteration of ADMM costs: no memory.
#![allow(clippy::expect_used, clippy::panic)]

#[path = "../../../crates/fem/tests/common/meshes.rs"]
mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use common::{bar, nodes_where};
use tissuereg_fem::Stiffness;
use tissuereg_paper::AdmmBody;

/// Counts requests for memory.
struct Counting;

thread_local! {
    /// Of this thread alone: the harness asks for memory, too, whenever it likes.
    static REQUESTS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        REQUESTS.set(REQUESTS.get() + 1);
        // SAFETY: the caller keeps the contract of `GlobalAlloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(place, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn iterations_ask_for_no_memory() {
    let mesh = bar([6, 2, 2], [60.0, 20.0, 20.0]);
    let held = nodes_where(&mesh, |x| x[0] < 1e-9);
    let soft = Stiffness::Uniform { young: 10.0, poisson: 0.45 };
    let mut body = AdmmBody::new(&mesh, &held, &soft, 1.0).expect("supported");
    body.set_parallel(false);
    // The first step makes the factor and the buffers of solutions.
    body.step(0.025, 1, None, None).expect("a step");
    let before = REQUESTS.get();
    body.step(0.025, 50, None, None).expect("a step");
    assert_eq!(REQUESTS.get(), before);
}
