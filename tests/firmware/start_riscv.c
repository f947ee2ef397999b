/* Start-up of QEMU's RISC-V board "virt" (RAM at 0x80000000), and as much of a C library as long.c calls. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#define UART (*(volatile unsigned char *)0x10000000U)
#define POWER (*(volatile uint32_t *)0x100000U) /* 0x5555 ends the emulator, 0x3333 with an exit code above it */

extern int main(void);
int printf(const char *format, ...);
void *memcpy(void *to, const void *from, size_t size);
void *memset(void *to, int value, size_t size);

void *memcpy(void *to, const void *from, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        ((unsigned char *)to)[i] = ((const unsigned char *)from)[i];
    }
    return to;
}

void *memset(void *to, int value, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        ((unsigned char *)to)[i] = (unsigned char)value;
    }
    return to;
}

/* Unsigned numbers alone: %08lX in eight digits, %lu in as many as it takes. */
static void number(unsigned long value, unsigned long base, int digits)
{
    if ((digits > 1) || (value >= base)) {
        number(value / base, base, digits - 1);
    }
    UART = (unsigned char)"0123456789ABCDEF"[value % base];
}

int printf(const char *format, ...)
{
    va_list values;
    va_start(values, format);
    for (const char *next = format; *next != '\0'; next++) {
        if (*next != '%') {
            UART = (unsigned char)*next;
            continue;
        }
        while ((*next != 'X') && (*next != 'u')) {
            next++;
        }
        number(va_arg(values, unsigned long), (*next == 'X') ? 16UL : 10UL, (*next == 'X') ? 8 : 1);
    }
    va_end(values);
    return 0;
}

__attribute__((noreturn, used)) static void begin(void)
{
    const int code = main();
    POWER = (code == 0) ? 0x5555U : (0x3333U | ((uint32_t)code << 16U));
    for (;;) {
    }
}

__attribute__((naked, section(".text.start"))) void _start(void)
{
    /* mstatus.FS: the floating-point unit on; traps end in an endless loop, which the test's time limit ends */
    __asm volatile("li sp, 0x80400000\n"
                   "li t0, 0x2000\n"
                   "csrs mstatus, t0\n"
                   "j begin\n");
}
