/*
 * Lets user-mode Linux 6.1 run on processors with AMX; `hil-tests/vcan` loads it in front of the C library there.
 *
 * With AMX the extended state of a process (NT_X86_XSTATE) is longer than that kernel knows, and the one below it takes
 * the whole state or nothing (EFAULT). A state that is too short is therefore laid over the present one. What lies behind
 * it is the state of AMX, which nobody uses in there: it has to be asked for with arch_prctl, which that kernel does not
 * know.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/uio.h>

long ptrace(enum __ptrace_request request, ...)
{
    static long (*real)(enum __ptrace_request, int, void *, void *);
    static char state[1 << 16]; /* One thread of that kernel traces. */
    va_list list;
    va_start(list, request);
    int process = va_arg(list, int);
    void *address = va_arg(list, void *);
    void *data = va_arg(list, void *);
    va_end(list);
    if (!real)
        real = dlsym(RTLD_NEXT, "ptrace");
    if (request != PTRACE_SETREGSET || address != (void *)NT_X86_XSTATE)
        return real(request, process, address, data);
    struct iovec *part = data, whole = {state, sizeof state};
    long result = real(PTRACE_GETREGSET, process, address, &whole);
    if (result != 0 || part->iov_len >= whole.iov_len)
        return result != 0 ? result : real(request, process, address, data);
    memcpy(state, part->iov_base, part->iov_len);
    return real(request, process, address, &whole);
}
