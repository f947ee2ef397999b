/* The part of <string.h> that the loop and the twin need: WebAssembly has instructions that copy and fill memory. */
#ifndef FRACLINK_WEB_STRING_H
#define FRACLINK_WEB_STRING_H

#include <stddef.h>

#define memcpy __builtin_memcpy
#define memmove __builtin_memmove
#define memset __builtin_memset

#endif
