// Preloaded into user-mode-linux where the processor's register state is larger than its buffer (AMX): the host kernel takes
// such a state back whole or not at all, so what the guest kernel did not keep is filled in from the process itself.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

long ptrace(enum __ptrace_request request, ...) {
    static long (*next)(enum __ptrace_request, pid_t, void *, void *);
    if (!next) next = dlsym(RTLD_NEXT, "ptrace");
    va_list arguments;
    va_start(arguments, request);
    pid_t pid = va_arg(arguments, pid_t);
    void *address = va_arg(arguments, void *);
    void *data = va_arg(arguments, void *);
    va_end(arguments);
    long result = next(request, pid, address, data);
    if (result == 0 || request != PTRACE_SETREGSET || address != (void *)NT_X86_XSTATE) return result;
    static char whole[16384];
    struct iovec *kept = data, all = {whole, sizeof whole};
    if (next(PTRACE_GETREGSET, pid, address, &all) != 0 || all.iov_len < kept->iov_len) return result;
    memcpy(whole, kept->iov_base, kept->iov_len);
    return next(PTRACE_SETREGSET, pid, address, &all);
}
