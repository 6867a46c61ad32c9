# Supervises a test machine: `sh -c SCRIPT sh DIRECTORY COMMAND...`, as the leader of a session of its own.
#
# Standard input is a pipe from the calling program. A line on the pipe starts the machine. The end of the pipe kills
# the machine with all its processes and removes the directory. However the calling program ends, the kernel closes the
# pipe. A machine that ends by itself leaves the directory until the end of the pipe.
#
# Some kernels share processor time among sessions. The session of the machine gets the niceness of the calling program.
directory=$1
shift
exec 3<&0 </dev/null 4>&2 2>/dev/null

if read -r _ <&3; then
    setsid sh -c '{ nice >/proc/self/autogroup; } 2>/dev/null; exec "$@"' sh "$@" 2>&4 3<&- 4>&- &
    machine=$!
    trap '' HUP INT QUIT TERM
    {
        read -r _
        # If the process is not yet the leader of a group, only the process is killed.
        kill -s KILL -- "-$machine" || kill -s KILL "$machine"
    } <&3 >/dev/null 4>&- &
    watcher=$!
    exec 4>&-
    wait "$machine"
    # The ID of an ended process may already be reused. The ID of its group is not reused while a member is left.
    kill -s KILL -- "-$machine"
    kill -s KILL "$watcher"
    # The reader of the machine's output sees the end of the output.
    exec >/dev/null
    read -r _ <&3
fi
rm -rf -- "$directory"
