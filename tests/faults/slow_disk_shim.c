/* Loaded into a process: each pwrite of more than 1 kB goes to the file in pieces of 1 kB with a pause between them, as on a
 * slow card, so that a kill meets the middle of a record. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <unistd.h>

enum { PIECE = 1024, PAUSE_US = 300 };

ssize_t pwrite64(int descriptor, const void *data, size_t size, off64_t at)
{
    static ssize_t (*kernels)(int, const void *, size_t, off64_t);
    if (!kernels)
        kernels = dlsym(RTLD_NEXT, "pwrite64");
    size_t done = 0;
    while (done < size) {
        ssize_t more = kernels(descriptor, (const char *)data + done, size - done < PIECE ? size - done : PIECE, at + done);
        if (more < 0)
            return done ? (ssize_t)done : more;
        done += more;
        if (done < size)
            usleep(PAUSE_US);
    }
    return done;
}

ssize_t pwrite(int descriptor, const void *data, size_t size, off_t at) { return pwrite64(descriptor, data, size, at); }
