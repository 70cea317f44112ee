/* driver.c: what the tests of the native library do with it; see test_library.py. Prints digests of snapshots. */
#define _GNU_SOURCE
#include <malloc.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "mbd.h"
#include "sha256.inc"

static void print_digest(mbd_model *m) {
    size_t count;
    unsigned char digest[32];
    const double *numbers = mbd_numbers(m, &count);
    sha256((const unsigned char *)numbers, 8 * count, digest);
    printf("%lld ", (long long)mbd_steps(m));
    for (int i = 0; i < 16; i++) printf("%02x", digest[i]);
    printf("\n");
}

static mbd_model *opened(const char *path) {
    mbd_model *m;
    int code = mbd_open(path, &m);
    if (code != MBD_OK) {
        printf("code %d: %s\n", code, mbd_text(code));
        exit(1);
    }
    return m;
}

static void steps(mbd_model *m, long n, long chunk) {
    for (long k = 0; k < n; k += chunk) {
        int code = mbd_step(m, chunk < n - k ? chunk : n - k);
        if (code != MBD_OK) {
            printf("code %d at %lld: %s\n", code, (long long)mbd_steps(m), mbd_message(m));
            return;
        }
    }
}

static char *content_of(const char *path, size_t *size) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) exit(2);
    fseek(file, 0, SEEK_END);
    *size = (size_t)ftell(file);
    rewind(file);
    char *content = malloc(*size);
    if (fread(content, 1, *size, file) != *size) exit(2);
    fclose(file);
    return content;
}

static uint64_t seed;
static uint64_t chance(uint64_t below) {
    seed ^= seed << 13, seed ^= seed >> 7, seed ^= seed << 17;
    return seed % below;
}

/* Content with a mutation: bytes changed, cut off, or repeated; returns its size. */
static size_t mutated(char *to, const char *from, size_t size) {
    memcpy(to, from, size);
    switch (chance(4)) {
    case 0:
        return chance(size);
    case 1: {
        size_t n = 1 + chance(size < 4096 ? size : 4096), a = chance(size - n + 1), b = chance(size - n + 1);
        memmove(to + a, to + b, n);
        return size;
    }
    default:
        for (uint64_t k = 1 + chance(8); k > 0; k--) to[chance(size)] ^= (char)(1 + chance(255));
        return size;
    }
}

/* Mutations of a model, or of its state after some steps: none may be taken unless nothing was changed. */
static void fuzz(const char *path, long count, int of_state) {
    mbd_model *m = opened(path), *other;
    size_t size = 0;
    char *content;
    if (of_state) {
        steps(m, 50, 50);
        content = malloc(size = mbd_size(m));
        mbd_save(m, content, size);
    } else content = content_of(path, &size);
    char *mutant = malloc(size);
    long taken = 0, codes[20] = {0};
    for (long k = 0; k < count; k++) {
        size_t n = mutated(mutant, content, size);
        if (n == size && memcmp(mutant, content, size) == 0) continue;
        int code = of_state ? mbd_restore(m, mutant, n) : mbd_make(mutant, n, &other);
        codes[code]++;
        taken += code == MBD_OK;
        if (!of_state) mbd_free(other);
    }
    printf("taken %ld damaged %ld version %ld\n", taken, codes[MBD_DAMAGED], codes[MBD_VERSION]);
    free(mutant);
    free(content);
    mbd_free(m);
}

/* Mutations of what says where things lie, with a digest that fits: loading must not read or write beside the file. */
static void fuzz_places(const char *path, long count, long first, long last) {
    size_t size;
    char *content = content_of(path, &size), *mutant = malloc(size);
    long refused = 0;
    for (long k = 0; k < count; k++) {
        mbd_model *other;
        memcpy(mutant, content, size);
        size_t at = (size_t)first + 8 * chance((uint64_t)(last - first) / 8);
        int64_t value = chance(2) ? (int64_t)chance(1u << 20) : chance(2) ? -(int64_t)chance(100) : (int64_t)chance(1ull << 62);
        memcpy(mutant + at, &value, 8);
        sha256((const unsigned char *)mutant + 48, size - 48, (unsigned char *)mutant + 16);
        int code = mbd_make(mutant, size, &other);
        refused += code != MBD_OK;
        mbd_free(other);
    }
    printf("refused %ld\n", refused);
    free(mutant);
    free(content);
}

/* Bytes that are allocated now. */
static size_t allocated(void) {
    struct mallinfo2 now = mallinfo2();
    return now.uordblks + now.hblkhd;
}

/* Growth of what is allocated, over `count` models that are made, copied and freed, behind ten that are not counted.
 * leak: bytes that every cycle keeps on purpose. */
static void cycle(const char *path, long count, size_t leak) {
    size_t before = 0;
    char *volatile kept = NULL;
    for (long k = -10; k < count; k++) {
        if (k == 0) before = allocated();
        mbd_model *m = opened(path), *copy;
        steps(m, 1, 1);
        mbd_copy(m, &copy);
        mbd_free(m);
        steps(copy, 1, 1);
        mbd_free(copy);
        if (leak > 0) kept = malloc(leak);
    }
    (void)kept;
    printf("grown %ld bytes\n", (long)(allocated() - before));
}

static void *in_thread(void *model) {
    steps(model, 200, 1);
    return NULL;
}

int main(int argc, char **argv) {
    const char *what = argv[1], *path = argv[2];
    seed = 88172645463325252ull;
    if (argc < 4) return 2;
    long n = atol(argv[3]);
    if (strcmp(what, "run") == 0) {
        mbd_model *m = opened(path);
        for (int i = 5; i + 1 < argc; i += 2) {
            int code = mbd_set(m, mbd_find(m, argv[i]), atof(argv[i + 1]));
            if (code != MBD_OK) printf("code %d: %s\n", code, mbd_message(m));
        }
        steps(m, n, atol(argv[4]));
        print_digest(m);
        int suspect = mbd_verdict(m);
        printf("verdict %d %s\n", suspect, mbd_message(m));
        for (int v = 0; v < mbd_variables(m); v++) {
            double value;
            mbd_get(m, v, &value);
            printf("%d|%s|%s|%a\n", mbd_kind(m, v), mbd_name(m, v), mbd_unit(m, v), value);
        }
        mbd_free(m);
    } else if (strcmp(what, "save") == 0) {
        mbd_model *m = opened(path);
        steps(m, n, 7);
        size_t size = mbd_size(m);
        void *state = malloc(size);
        mbd_save(m, state, size);
        FILE *file = fopen(argv[4], "wb");
        fwrite(state, 1, size, file);
        fclose(file);
        free(state);
        mbd_free(m);
    } else if (strcmp(what, "restore") == 0) {
        size_t size;
        char *state = content_of(argv[4], &size);
        mbd_model *m = opened(path), *copy;
        steps(m, 13, 13);
        int code = mbd_restore(m, state, size);
        if (code != MBD_OK) printf("code %d: %s\n", code, mbd_message(m));
        mbd_copy(m, &copy);
        steps(m, 11, 1);
        mbd_reset(m);
        mbd_free(m);
        steps(copy, n, 100);
        print_digest(copy);
        mbd_free(copy);
        free(state);
    } else if (strcmp(what, "fuzz") == 0) fuzz(path, n, argc > 4);
    else if (strcmp(what, "places") == 0) fuzz_places(path, n, atol(argv[4]), atol(argv[5]));
    else if (strcmp(what, "cycle") == 0) cycle(path, n, argc > 4 ? (size_t)atol(argv[4]) : 0);
    else if (strcmp(what, "threads") == 0) {
        pthread_t thread[2];
        mbd_model *m[2] = {opened(path), NULL};
        mbd_copy(m[0], &m[1]);
        for (int i = 0; i < 2; i++) pthread_create(&thread[i], NULL, in_thread, m[i]);
        for (int i = 0; i < 2; i++) pthread_join(thread[i], NULL), print_digest(m[i]);
    } else return 2;
    return 0;
}
