/* Loaded into a process: each write of more than 1 kB goes to the file in pieces of 1 kB with a pause between them, as on a
 * slow card, so that a kill meets the middle of a record. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <unistd.h>

enum { PIECE = 1024, PAUSE_US = 300 };

static ssize_t in_pieces(int descriptor, const char *data, size_t size, off64_t at, int is_placed)
{
    static ssize_t (*write_on)(int, const void *, size_t);
    static ssize_t (*write_at)(int, const void *, size_t, off64_t);
    if (!write_on) {
        write_at = dlsym(RTLD_NEXT, "pwrite64");
        write_on = dlsym(RTLD_NEXT, "write");
    }
    size_t done = 0;
    while (done < size) {
        size_t piece = size - done < PIECE ? size - done : PIECE;
        ssize_t more =
            is_placed ? write_at(descriptor, data + done, piece, at + done) : write_on(descriptor, data + done, piece);
        if (more < 0)
            return done ? (ssize_t)done : more;
        done += more;
        if (done < size)
            usleep(PAUSE_US);
    }
    return done;
}

ssize_t write(int descriptor, const void *data, size_t size) { return in_pieces(descriptor, data, size, 0, 0); }

ssize_t pwrite64(int descriptor, const void *data, size_t size, off64_t at)
{
    return in_pieces(descriptor, data, size, at, 1);
}

ssize_t pwrite(int descriptor, const void *data, size_t size, off_t at) { return pwrite64(descriptor, data, size, at); }
