//! Generators that the compiler refuses, with its messages (`tests/refused/*.stderr`).
//!
//! The messages are those of the present compiler. `TRYBUILD=overwrite cargo test -p mrroc-controller --test generators`
//! writes them again: read each one as a user would.

#[test]
fn generators_that_read_more_than_they_declare_do_not_compile() {
    trybuild::TestCases::new().compile_fail("tests/refused/*.rs");
}
