/* Loaded into a process: each write to a file, and each flush, takes SLOW_US microseconds, as on a card that is worn out.
 * Not those of standard output and error. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

static void pause_for(int descriptor)
{
    struct stat status;
    if (descriptor > 2 && !fstat(descriptor, &status) && (S_ISREG(status.st_mode) || S_ISDIR(status.st_mode)))
        usleep(atoi(getenv("SLOW_US")));
}

ssize_t write(int descriptor, const void *data, size_t size)
{
    static ssize_t (*kernels)(int, const void *, size_t);
    if (!kernels)
        kernels = dlsym(RTLD_NEXT, "write");
    pause_for(descriptor);
    return kernels(descriptor, data, size);
}

int fsync(int descriptor)
{
    static int (*kernels)(int);
    if (!kernels)
        kernels = dlsym(RTLD_NEXT, "fsync");
    pause_for(descriptor);
    return kernels(descriptor);
}
