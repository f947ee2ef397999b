/* Function multiversioning: the loader selects the widest vectors of the machine, and one binary serves all
 * machines. */
#ifndef FRACLINK_CLONES_H
#define FRACLINK_CLONES_H

#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 12 && defined(__x86_64__) && defined(__GLIBC__)
#define FRACLINK_CLONES __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define FRACLINK_CLONES
#endif

#endif
