# Supervises a test machine: `sh -c SCRIPT sh DIRECTORY COMMAND...`, as the leader of a session of its own.
#
# Standard input is a pipe from the program that wants the machine. A line on the pipe starts the machine. The end of the
# pipe, which the kernel brings about however that program ends, kills the machine with all its processes and removes the
# directory. A machine that ends by itself leaves the directory until the end of the pipe.
directory=$1
shift
exec 3<&0 </dev/null 4>&2 2>/dev/null

# The machine's process group; or the process alone, if it did not become the leader of a group yet.
kill_machine() {
    kill -s KILL -- "-$machine" || kill -s KILL "$machine"
}

if read -r _ <&3; then
    setsid "$@" 2>&4 3<&- 4>&- &
    machine=$!
    trap '' HUP INT QUIT TERM
    {
        read -r _
        kill_machine
    } <&3 >/dev/null 4>&- &
    watcher=$!
    exec 4>&-
    wait "$machine"
    kill_machine
    kill -s KILL "$watcher"
    # Who reads the machine's output sees its end.
    exec >/dev/null
    read -r _ <&3
fi
rm -rf -- "$directory"
