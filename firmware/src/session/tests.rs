extern crate std;

use std::vec::Vec;

use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::frame::encode;
use ftcal_shared::wire::{Rejection, Request, RequestId, Response, ToDevice, ToHost};

use super::{HOST_SILENCE_MICROS, Order, RATE_TRIAL_MICROS, Session, Silence, Ticket, hello};
use crate::baud::DEFAULT_BAUD;

const QUIET: Silence = Silence { end_stream: false, fall_back: false };

fn at(micros: u64) -> DeviceTime {
    DeviceTime::from_micros(micros)
}

fn orders(session: &mut Session, bytes: &[u8], now: DeviceTime) -> Vec<Order> {
    bytes.iter().filter_map(|&byte| session.on_byte(byte, now)).collect()
}

fn order(session: &mut Session, message: &ToDevice, now: DeviceTime) -> Option<Order> {
    let mut orders = orders(session, &encode(message).expect("it fits"), now);
    assert!(orders.len() <= 1);
    orders.pop()
}

/// What is asked for by [`start`], after so many greetings.
fn serve(id: RequestId, conversation: u8) -> Order {
    Order::Serve(Ticket { id, conversation }, Request::StartTrial { rank: 3 })
}

fn start(id: RequestId) -> ToDevice {
    ToDevice::Request(id, Request::StartTrial { rank: 3 })
}

#[test]
fn a_request_that_comes_again_is_answered_again_and_served_once() {
    let mut session = Session::new();
    assert_eq!(order(&mut session, &start(7), at(0)), Some(serve(7, 0)));
    // While it is being worked on there is nothing to say.
    assert_eq!(order(&mut session, &start(7), at(1)), None);
    let response = Response::Rejected(Rejection::TrialBusy);
    let message = ToHost::Response(7, response.clone());
    assert_eq!(session.answer(Ticket { id: 7, conversation: 0 }, response), Some(message.clone()));
    let answer = Some(Order::Send(message));
    assert_eq!(order(&mut session, &start(7), at(2)), answer);
    assert_eq!(order(&mut session, &start(7), at(3)), answer);
    // Another number is another request; an answer to one before is not taken for its answer.
    assert_eq!(order(&mut session, &start(8), at(4)), Some(serve(8, 0)));
    let _ = session.answer(Ticket { id: 7, conversation: 0 }, Response::Done);
    assert_eq!(order(&mut session, &start(8), at(5)), None);
    // A greeting begins anew, and what was asked before it is not answered any more.
    assert_eq!(order(&mut session, &ToDevice::Hello, at(6)), Some(Order::Send(ToHost::Hello(hello()))));
    assert_eq!(order(&mut session, &start(8), at(7)), Some(serve(8, 1)));
    assert_eq!(session.answer(Ticket { id: 8, conversation: 0 }, Response::Done), None);
    assert_eq!(order(&mut session, &start(8), at(8)), None);
}

#[test]
fn garbage_costs_at_most_the_frame_that_it_runs_into() {
    let mut state = 1_u32;
    let mut random = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 8
    };
    for _ in 0..3000 {
        let mut session = Session::new();
        let mut bytes: Vec<u8> = (0..random() % 1500).map(|_| random().to_le_bytes()[0]).collect();
        let ends_a_frame = bytes.last().is_none_or(|last| *last == 0);
        bytes.extend(encode(&start(1)).expect("it fits"));
        bytes.extend(encode(&start(2)).expect("it fits"));
        let served: Vec<RequestId> = orders(&mut session, &bytes, at(0))
            .into_iter()
            .map(|order| match order {
                Order::Serve(Ticket { id, .. }, Request::StartTrial { rank: 3 }) => id,
                other => panic!("{other:?} was not asked for"),
            })
            .collect();
        let expected: &[RequestId] = if ends_a_frame { &[1, 2] } else { &[2] };
        assert_eq!(served, expected);
    }
}

#[test]
fn a_host_that_says_nothing_is_gone_after_a_while() {
    let mut session = Session::new();
    order(&mut session, &ToDevice::Hello, at(1000));
    assert_eq!(session.watch(at(1000 + HOST_SILENCE_MICROS)), QUIET);
    // Noise is no word.
    orders(&mut session, &[1, 2, 3, 0], at(1000 + HOST_SILENCE_MICROS));
    assert_eq!(session.broken_frames(), 1);
    let gone = Silence { end_stream: true, fall_back: false };
    assert_eq!(session.watch(at(1001 + HOST_SILENCE_MICROS)), gone);
    order(&mut session, &start(1), at(2000 + HOST_SILENCE_MICROS));
    assert_eq!(session.watch(at(2001 + HOST_SILENCE_MICROS)), QUIET);
}

#[test]
fn a_rate_at_which_nothing_is_heard_is_given_up() {
    let mut session = Session::new();
    let change = ToDevice::Request(1, Request::ChangeRate(2_000_000));
    let ticket = Ticket { id: 1, conversation: 0 };
    let ordered = Some(Order::ChangeRate(ticket, 2_000_000));
    assert_eq!(order(&mut session, &change, at(0)), ordered);
    let _ = session.answer(ticket, Response::Done);
    session.rate_changed(2_000_000, at(0));
    assert_eq!(session.watch(at(RATE_TRIAL_MICROS)), QUIET);
    assert!(session.watch(at(RATE_TRIAL_MICROS + 1)).fall_back);
    session.rate_changed(DEFAULT_BAUD, at(RATE_TRIAL_MICROS + 1));
    assert!(!session.watch(at(RATE_TRIAL_MICROS + 2)).fall_back);
    // Asked for once more, even under the same number, it is changed to once more.
    assert_eq!(order(&mut session, &change, at(RATE_TRIAL_MICROS + 3)), ordered);
}

#[test]
fn a_rate_that_works_is_kept_as_long_as_somebody_is_there() {
    let mut session = Session::new();
    session.rate_changed(2_000_000, at(0));
    order(&mut session, &start(1), at(RATE_TRIAL_MICROS));
    let gone = RATE_TRIAL_MICROS + HOST_SILENCE_MICROS + 1;
    assert!(!session.watch(at(gone - 1)).fall_back);
    assert_eq!(session.watch(at(gone)), Silence { end_stream: true, fall_back: true });
}
