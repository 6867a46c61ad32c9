/* Lets user-mode Linux run on processors with large register files.
 *
 * User-mode Linux sets the floating-point registers of its processes through ptrace(2), in a buffer whose size was chosen
 * when the kernel was built. Since Linux 5.16, the host takes a buffer of its own size only, which is larger on processors
 * with AMX tiles: every process of the machine then ends at its first instruction. This library, loaded before the C
 * library, completes the buffer with the present values of the other registers. */
/* Other processors have no such registers, and need no function. */
#ifdef __x86_64__

#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

/* Larger than the registers of any processor; the kernel's own documentation expects 11 kB with AMX. */
#define MOST 65536

long ptrace(enum __ptrace_request request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    pid_t pid = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);

    if (request == PTRACE_SETREGSET && (unsigned long)address == NT_X86_XSTATE) {
        static char registers[MOST] __attribute__((aligned(64)));
        const struct iovec *given = data;
        struct iovec whole = {registers, MOST};
        if (syscall(SYS_ptrace, PTRACE_GETREGSET, pid, address, &whole) == 0 && whole.iov_len > given->iov_len) {
            memcpy(registers, given->iov_base, given->iov_len);
            return syscall(SYS_ptrace, request, pid, address, &whole);
        }
    }
    if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
        /* The system call stores the word, and the function returns it. */
        long word;
        long result = syscall(SYS_ptrace, request, pid, address, &word);
        if (result < 0)
            return result;
        errno = 0;
        return word;
    }
    return syscall(SYS_ptrace, request, pid, address, data);
}

#endif
