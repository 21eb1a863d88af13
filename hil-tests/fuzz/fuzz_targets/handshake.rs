#![no_main]
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| hil_tests::arbitrary::handshake(bytes));
