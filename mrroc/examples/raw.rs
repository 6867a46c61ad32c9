fn main() {
    let file = mrroc::cell::CellFile::read(std::env::args().nth(1).unwrap()).unwrap();
    mrroc::fault_table::raw(&file).unwrap();
}
