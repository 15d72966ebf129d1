/* Firmware of the Tripod's servo board: ATmega328P at 16 MHz (Uno, Nano), plain C, no Arduino core.
 *
 * Three hobby servos on pins 9, 10, 11 (PB1, PB2, PB3), commands on the serial line at 115200 baud. The packets,
 * the rules and the build switches are described in README.md beside this file.
 *
 * How the work is cut:
 *   - The Timer1 interrupt makes the edges. It is armed EARLY ticks before an edge and then waits for the exact
 *     tick, so that another interrupt that happens to run at that moment delays no edge.
 *   - The serial interrupts only move bytes between the line and two ring buffers. They hold no arithmetic: an
 *     interrupt longer than EARLY would move the edges, that is, twitch the servos.
 *   - Everything else (parsing, limits, slew, telemetry) runs in main, woken by bytes and once a frame.
 */
#include <avr/eeprom.h>
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>
#include <stdint.h>
#include <util/atomic.h>

#if defined(IMU) && !defined(LEGACY_ONLY)
#define LEGACY_ONLY /* the text protocol has neither frames nor telemetry */
#endif

#define PROTOCOL_VERSION 2
#define FIRMWARE_MAJOR 2
#define FIRMWARE_MINOR 2

/* Time: Timer1 counts 0.5 us ticks and is never reset. */
#define TICKS_PER_US 2u
#define FRAME_TICKS (20000u * TICKS_PER_US)
#define SLOT_TICKS (3000u * TICKS_PER_US)   /* the three pulses of a frame start 3 ms apart */
#define MOVE_TICKS (17000u * TICKS_PER_US)  /* in a frame: when main is asked for the widths of the next one */
#define LATCH_TICKS (19000u * TICKS_PER_US) /* in a frame: when they are taken over */
#define EARLY_TICKS (12u * TICKS_PER_US)
#define MARGIN_TICKS 8

/* Servo pulses. An angle byte a is 544 + a * 1856 / 180 us, as in the usual servo libraries. */
#define SERVOS 3u
#define WIDTH_MIN_US 544u
#define WIDTH_MAX_US 2400u
#define LATCH_PHASE (2 * SERVOS + 1) /* of the timer interrupt: two edges a servo, move, latch */
#define SPAN_US (WIDTH_MAX_US - WIDTH_MIN_US)
#define ANGLE_MIN 60u
#define ANGLE_MAX 180u
#define ANGLE_REST 150u
#define ANGLE_TICKS(a) ((uint16_t)(WIDTH_MIN_US * TICKS_PER_US + ((uint32_t)(a) * SPAN_US * TICKS_PER_US + 90u) / 180u))

/* Motion, per frame of 20 ms. */
#define SLEW_TICKS 122u     /* 61 us: 5.92 degrees a frame, 296 degrees a second */
#define SLEW_MAX_US 124u    /* 12 degrees a frame: as fast as a free-running hobby servo */
#define CREEP_TICKS 20u     /* 10 us: 0.97 degrees a frame on the way to rest */
#define HOLD_FRAMES 25u     /* 0.5 s of silence */
#define REST_FRAMES 100u    /* 2 s of silence */
#define STUCK_FRAMES 6u     /* main has not fed the watchdog for so long: remember it over the reset */
#define PARTIAL_TICKS (40000ul * TICKS_PER_US)
#define PARTIAL_FRAMES 3u   /* so many frames last longer than PARTIAL_TICKS, whatever the phase */

/* Serial protocol. */
#define LEGACY_HEADER 0xFFu
#define FRAME_HEADER 0xFEu
#define SEXTET 0x80u
enum { SET = 1, RELAX = 2, HOLD = 3, PING = 4, SET_LIMITS = 5, SLEW = 6, IDENTIFY = 7, BANNER = 16, TELEMETRY = 17, IDENTITY = 18 };
enum {
    FLAG_LINK = 1u << 0,
    FLAG_HOLD = 1u << 1,
    FLAG_HOMING = 1u << 2,
    FLAG_ACTIVE = 1u << 3,
    FLAG_RELAXED = 1u << 4,
    FLAG_LIMITS = 1u << 5,
    FLAG_WATCHDOG = 1u << 6,
};
#define PAYLOAD_MAX 18u
#define IDENTITY_SEXTETS 8u /* the board's number: 48 bits */
#define IDENTITY_PLACE 16u  /* in the EEPROM; its first bytes are those that a failing supply damages */

/* ---- shared between interrupts and main ------------------------------------------------------------------ */

static volatile uint16_t next_width[SERVOS]; /* in ticks, taken over once a frame */
static volatile uint8_t next_active;         /* whether the next frame has pulses */
static volatile uint16_t frame_start;        /* Timer1 at the start of the running frame */
static volatile uint32_t frame_ticks;        /* frame_start without the wrap at 2^16 */
static volatile uint8_t move_due;            /* set once a frame, after its last pulse; main clears it */
static volatile uint8_t frames_unfed;        /* frames since main last fed the watchdog */

#define RX_SIZE 64u
#define TX_SIZE 64u
static volatile uint8_t rx_ring[RX_SIZE], rx_head, rx_tail;
static volatile uint8_t tx_ring[TX_SIZE], tx_head, tx_tail;
static volatile uint16_t overruns;

/* Survives a reset: a boot loader clears the register that tells why there was one. */
#define MAGIC 0x5AC3u
static volatile uint16_t stuck_mark __attribute__((section(".noinit")));
static volatile uint16_t stuck_mark_inverse __attribute__((section(".noinit")));
static uint8_t reset_cause __attribute__((section(".noinit")));
static uint16_t kept[SERVOS + 1] __attribute__((section(".noinit"))); /* newest widths of pulses, and their sum */

/* ---- pulses ---------------------------------------------------------------------------------------------- */

ISR(TIMER1_COMPA_vect)
{
    static uint16_t width[SERVOS];
    static uint16_t edge; /* the tick of this edge */
    static uint8_t active, phase = LATCH_PHASE;
    uint8_t port = 0;

    if (phase < 2 * SERVOS && !(phase & 1) && active)
        port = (uint8_t)(1u << (PORTB1 + phase / 2));
    if (phase < 2 * SERVOS) {
        while ((int16_t)(TCNT1 - edge) < 0)
            ;
        PORTB = port;
    }

    switch (phase) { /* set the time of the next edge */
    case 0: edge = frame_start + width[0]; break;
    case 1: edge = frame_start + SLOT_TICKS; break;
    case 2: edge = frame_start + SLOT_TICKS + width[1]; break;
    case 3: edge = frame_start + 2 * SLOT_TICKS; break;
    case 4: edge = frame_start + 2 * SLOT_TICKS + width[2]; break;
    case 5: edge = frame_start + MOVE_TICKS; break;
    case 6:
        edge = frame_start + LATCH_TICKS;
        move_due = 1;
        if (++frames_unfed > STUCK_FRAMES) {
            stuck_mark = MAGIC;
            stuck_mark_inverse = (uint16_t)~MAGIC;
        }
        break;
    default:
        for (uint8_t i = 0; i < SERVOS; i++)
            width[i] = next_width[i];
        active = next_active;
        frame_start += FRAME_TICKS;
        frame_ticks += FRAME_TICKS;
        edge = frame_start;
        break;
    }
    phase = phase < LATCH_PHASE ? phase + 1 : 0;
    OCR1A = edge - EARLY_TICKS;
    if ((int16_t)(OCR1A - TCNT1) < MARGIN_TICKS) /* a moment already gone would come again only after 33 ms */
        OCR1A = TCNT1 + MARGIN_TICKS;
}

/* ---- serial line ----------------------------------------------------------------------------------------- */

ISR(USART_RX_vect)
{
    uint8_t status = UCSR0A;
    uint8_t byte = UDR0;
    uint8_t next = (rx_head + 1) & (RX_SIZE - 1);
    if (status & (1 << FE0))
        byte = 0; /* belongs to no packet, and so drops the one it falls into */
    if ((status & (1 << DOR0)) || next == rx_tail)
        overruns++;
    if (next != rx_tail) {
        rx_ring[rx_head] = byte;
        rx_head = next;
    }
}

ISR(USART_UDRE_vect)
{
    if (tx_tail == tx_head) {
        UCSR0B &= (uint8_t)~(1 << UDRIE0);
        return;
    }
    UDR0 = tx_ring[tx_tail];
    tx_tail = (tx_tail + 1) & (TX_SIZE - 1);
}

#ifndef LEGACY_ONLY
static uint8_t crc8(uint8_t crc, uint8_t value)
{
    crc ^= value;
    for (uint8_t i = 0; i < 8; i++)
        crc = crc & 0x80 ? (uint8_t)(crc << 1) ^ 0x07 : (uint8_t)(crc << 1);
    return crc;
}

/* Queue a frame; without room it is dropped whole, the next telemetry says the same and more. */
static void send_frame(uint8_t type, const uint8_t *payload, uint8_t length)
{
    static uint8_t sequence;
    uint8_t crc = 0;
    uint8_t head = tx_head;
    uint8_t used = (head - tx_tail) & (TX_SIZE - 1);
    if (length + 5u >= TX_SIZE - used)
        return;
#define PUT(byte) (tx_ring[head] = (byte), head = (head + 1) & (TX_SIZE - 1))
    PUT(FRAME_HEADER);
    PUT(SEXTET | type);
    crc = crc8(crc, type);
    PUT(SEXTET | sequence);
    crc = crc8(crc, sequence);
    for (uint8_t i = 0; i < length; i++) {
        PUT(SEXTET | payload[i]);
        crc = crc8(crc, payload[i]);
    }
    PUT(SEXTET | (crc >> 6));
    PUT(SEXTET | (crc & 0x3F));
#undef PUT
    sequence = (sequence + 1) & 0x3F;
    ATOMIC_BLOCK(ATOMIC_FORCEON)
    {
        tx_head = head;
        UCSR0B |= 1 << UDRIE0;
    }
}
#endif

/* ---- motion ---------------------------------------------------------------------------------------------- */

static uint16_t target[SERVOS], current[SERVOS]; /* in ticks */
static uint16_t lowest[SERVOS], highest[SERVOS], rest[SERVOS]; /* in ticks */
static uint16_t slew = SLEW_TICKS;
static uint8_t started;   /* a pose was commanded since the reset */
static uint8_t known;     /* where the servos were at the reset */
static uint8_t relaxed;
static uint8_t hold_asked; /* latched: only a pose in a frame ends it, silence does not */
static uint8_t silence = 255; /* frames since the last valid command, saturating */

static uint16_t within(uint16_t value, uint16_t low, uint16_t high)
{
    return value < low ? low : value > high ? high : value;
}

static void stop_moving(void)
{
    for (uint8_t i = 0; i < SERVOS; i++)
        target[i] = current[i];
}

static void command_pose(const uint16_t *ticks)
{
    for (uint8_t i = 0; i < SERVOS; i++) {
        target[i] = within(ticks[i], lowest[i], highest[i]);
        if (!started && !known)
            current[i] = target[i]; /* where the servos are is not known: there is nothing to slew from */
    }
    started = 1;
    relaxed = 0;
    hold_asked = 0;
    silence = 0;
}

/* What tells kept widths from what a loss of power leaves in the memory. */
static uint16_t sum_of_kept(void)
{
    uint16_t sum = MAGIC;
    for (uint8_t i = 0; i < SERVOS; i++)
        sum = (uint16_t)(sum << 1 | sum >> 15) ^ kept[i];
    return sum;
}

static uint8_t is_kept(void)
{
    for (uint8_t i = 0; i < SERVOS; i++)
        if (kept[i] < WIDTH_MIN_US * TICKS_PER_US || kept[i] > WIDTH_MAX_US * TICKS_PER_US)
            return 0;
    return kept[SERVOS] == sum_of_kept();
}

static void keep_widths(void)
{
    for (uint8_t i = 0; i < SERVOS; i++)
        kept[i] = current[i];
    kept[SERVOS] = sum_of_kept();
}

static void move_one_frame(void)
{
    uint16_t step = slew;
    if (silence < 255)
        silence++;
    if (silence == HOLD_FRAMES)
        stop_moving();
#ifndef LEGACY_ONLY /* a line without a word to stop: after a stop nobody could say that silence must not move */
    if (silence >= REST_FRAMES && !hold_asked) {
        for (uint8_t i = 0; i < SERVOS; i++)
            target[i] = rest[i];
        if (step > CREEP_TICKS)
            step = CREEP_TICKS;
    }
#endif
    for (uint8_t i = 0; i < SERVOS && started && !relaxed; i++) { /* without pulses the servos stay where they were */
        uint16_t wanted = within(target[i], lowest[i], highest[i]);
        uint16_t from = current[i];
        if (wanted > from)
            current[i] = wanted - from > step ? from + step : wanted;
        else
            current[i] = from - wanted > step ? from - step : wanted;
    }
    ATOMIC_BLOCK(ATOMIC_FORCEON)
    {
        for (uint8_t i = 0; i < SERVOS; i++)
            next_width[i] = current[i];
        next_active = started && !relaxed;
    }
    if (started && !relaxed)
        keep_widths();
}

/* ---- parser ---------------------------------------------------------------------------------------------- */

#ifdef IMU
#include "imu.h"
#else

/* Ticks from some moment on, modulo 2^32 (36 minutes): for differences. */
static uint32_t now_ticks(void)
{
    uint32_t frames;
    uint16_t start, counter;
    ATOMIC_BLOCK(ATOMIC_FORCEON)
    {
        frames = frame_ticks;
        start = frame_start;
        counter = TCNT1;
    }
    /* frame_start runs ahead of the counter for the last millisecond of a frame */
    return frames + (uint32_t)(int32_t)(int16_t)(counter - start - FRAME_TICKS / 2);
}

static enum { IDLE, LEGACY, TYPE, SEQUENCE, PAYLOAD, CRC_HIGH, CRC_LOW } state;
static uint32_t packet_started;
static uint8_t buffer[PAYLOAD_MAX];
static uint8_t filled;
static uint16_t rejects;
#ifndef LEGACY_ONLY
static uint8_t frame_type, frame_sequence, frame_length, frame_crc, crc_high;
static uint8_t accepted_sequence;
static uint8_t telemetry_wanted;
static uint8_t limits_set;
static uint8_t framed; /* the last valid command was a frame */
static uint8_t identity[IDENTITY_SEXTETS]; /* 63 each, as an erased EEPROM reads: the board has no number yet */
static uint8_t identity_unwritten;         /* sextets that the EEPROM has still to take */
static uint8_t identity_wanted;
#endif
static uint8_t partial_frames; /* servo frames since the packet begun */

static void reject(void)
{
    state = IDLE;
    rejects++;
}

static void take_legacy(void)
{
    uint16_t ticks[SERVOS];
#ifndef LEGACY_ONLY
    /* One flipped bit makes a legacy packet of a frame's first bytes; and it never ends a hold. */
    if (hold_asked || (framed && silence < HOLD_FRAMES)) {
        rejects++;
        return;
    }
    framed = 0;
#endif
    for (uint8_t i = 0; i < SERVOS; i++)
        ticks[i] = ANGLE_TICKS(buffer[i]);
    command_pose(ticks);
}

#ifndef LEGACY_ONLY
/* Payload length of a frame from the host, or 255 for a type that is none. */
static uint8_t length_of(uint8_t type)
{
    switch (type) {
    case SET: return 6;
    case RELAX:
    case HOLD:
    case PING: return 0;
    case SET_LIMITS: return 18;
    case SLEW: return 2;
    case IDENTIFY: return IDENTITY_SEXTETS;
    default: return 255;
    }
}

static uint16_t twelve_bits(uint8_t index)
{
    return (uint16_t)buffer[2 * index] << 6 | buffer[2 * index + 1];
}

static uint8_t is_identity(const uint8_t *sextets)
{
    for (uint8_t i = 0; i < IDENTITY_SEXTETS; i++)
        if (sextets[i] != 0x3F)
            return 1;
    return 0;
}

static uint8_t is_width(uint16_t us)
{
    return us >= WIDTH_MIN_US && us <= WIDTH_MAX_US;
}

/* Carry out a frame whose checksum is right; 0 where a value of it is not allowed (then nothing of it is done). */
static uint8_t take_frame(void)
{
    uint16_t value[3 * SERVOS];
    switch (frame_type) {
    case SET:
        for (uint8_t i = 0; i < SERVOS; i++) {
            value[i] = twelve_bits(i);
            if (!is_width(value[i]))
                return 0;
            value[i] *= TICKS_PER_US;
        }
        command_pose(value);
        break;
    case RELAX:
        relaxed = 1;
        stop_moving();
        break;
    case HOLD:
        hold_asked = 1;
        stop_moving();
        break;
    case PING:
        telemetry_wanted = 1;
        break;
    case SET_LIMITS:
        for (uint8_t i = 0; i < 3 * SERVOS; i++) { /* least, rest, largest: each not below the one before */
            value[i] = twelve_bits(i);
            if (!is_width(value[i]) || (i % 3 && value[i - 1] > value[i]))
                return 0;
        }
        for (uint8_t i = 0; i < SERVOS; i++) {
            lowest[i] = value[3 * i] * TICKS_PER_US;
            rest[i] = value[3 * i + 1] * TICKS_PER_US;
            highest[i] = value[3 * i + 2] * TICKS_PER_US;
        }
        limits_set = 1;
        break;
    case SLEW:
        value[0] = twelve_bits(0);
        if (value[0] < 1 || value[0] > SLEW_MAX_US)
            return 0;
        slew = value[0] * TICKS_PER_US;
        break;
    case IDENTIFY: /* a number is taken once and kept for good */
        if (!is_identity(identity) && is_identity(buffer)) {
            for (uint8_t i = 0; i < IDENTITY_SEXTETS; i++)
                identity[i] = buffer[i];
            identity_unwritten = IDENTITY_SEXTETS;
        }
        identity_wanted = 1;
        break;
    }
    if (silence >= HOLD_FRAMES) /* the line is back, without a pose: stay where it finds the servos */
        stop_moving();
    silence = 0;
    framed = 1;
    return 1;
}
#endif

/* Once a frame: half a packet is gone before the clock of its age can wrap. */
static void drop_old_packet(void)
{
    if (state != IDLE && ++partial_frames >= PARTIAL_FRAMES)
        reject();
}

static void parse(uint8_t byte)
{
    uint32_t now = now_ticks();
    if (state != IDLE && now - packet_started > PARTIAL_TICKS)
        reject();

    if (byte >= FRAME_HEADER) { /* a header starts a packet wherever it comes */
        if (state != IDLE)
            reject();
#ifdef LEGACY_ONLY
        if (byte != LEGACY_HEADER)
            return;
#endif
        state = byte == LEGACY_HEADER ? LEGACY : TYPE;
        packet_started = now;
        partial_frames = 0;
        filled = 0;
        return;
    }
    if (state == IDLE)
        return;
    if (state == LEGACY) {
        if (byte < ANGLE_MIN || byte > ANGLE_MAX) {
            reject();
            return;
        }
        buffer[filled++] = byte;
        if (filled == SERVOS) {
            state = IDLE;
            take_legacy();
        }
        return;
    }
#ifndef LEGACY_ONLY
    if ((byte & 0xC0) != SEXTET) {
        reject();
        return;
    }
    byte &= 0x3F;
    switch (state) {
    case TYPE:
        frame_type = byte;
        frame_length = length_of(byte);
        frame_crc = crc8(0, byte);
        state = SEQUENCE;
        if (frame_length == 255)
            reject();
        break;
    case SEQUENCE:
        frame_sequence = byte;
        frame_crc = crc8(frame_crc, byte);
        state = frame_length ? PAYLOAD : CRC_HIGH;
        break;
    case PAYLOAD:
        buffer[filled++] = byte;
        frame_crc = crc8(frame_crc, byte);
        if (filled == frame_length)
            state = CRC_HIGH;
        break;
    case CRC_HIGH:
        crc_high = byte;
        state = CRC_LOW;
        break;
    default:
        if (crc_high == frame_crc >> 6 && byte == (frame_crc & 0x3F) && take_frame()) {
            accepted_sequence = frame_sequence;
            state = IDLE;
        } else {
            reject();
        }
        break;
    }
#endif
}

#endif /* IMU */

/* ---- telemetry ------------------------------------------------------------------------------------------- */

#ifndef LEGACY_ONLY
static void put_twelve_bits(uint8_t *place, uint16_t value)
{
    place[0] = (value >> 6) & 0x3F;
    place[1] = value & 0x3F;
}

static void send_banner(void)
{
    const uint8_t payload[4] = {PROTOCOL_VERSION, FIRMWARE_MAJOR, FIRMWARE_MINOR, reset_cause};
    send_frame(BANNER, payload, sizeof payload);
}

static void send_telemetry(void)
{
    uint8_t payload[13];
    uint8_t flags = 0;
    uint8_t pulses = started && !relaxed;
    uint16_t lost;
    ATOMIC_BLOCK(ATOMIC_FORCEON) { lost = overruns; }
    if (silence < HOLD_FRAMES)
        flags |= FLAG_LINK;
    if (started && (hold_asked || (silence >= HOLD_FRAMES && silence < REST_FRAMES)))
        flags |= FLAG_HOLD;
    if (pulses && !hold_asked && silence >= REST_FRAMES)
        flags |= FLAG_HOMING;
    if (pulses)
        flags |= FLAG_ACTIVE;
    if (relaxed)
        flags |= FLAG_RELAXED;
    if (limits_set)
        flags |= FLAG_LIMITS;
    if (reset_cause & (1 << WDRF))
        flags |= FLAG_WATCHDOG;
    payload[0] = accepted_sequence;
    put_twelve_bits(payload + 1, flags);
    for (uint8_t i = 0; i < SERVOS; i++)
        put_twelve_bits(payload + 3 + 2 * i, pulses || (known && !started) ? (current[i] + 1) / TICKS_PER_US : 0);
    put_twelve_bits(payload + 9, rejects & 0xFFF);
    put_twelve_bits(payload + 11, lost & 0xFFF);
    send_frame(TELEMETRY, payload, sizeof payload);
}

/* One sextet a frame: the EEPROM takes 3.4 ms for it, and nothing waits. */
static void write_identity(void)
{
    if (identity_unwritten && eeprom_is_ready()) {
        identity_unwritten--;
        eeprom_write_byte((uint8_t *)IDENTITY_PLACE + identity_unwritten, identity[identity_unwritten]);
    }
}
#endif

/* ---- start and main loop --------------------------------------------------------------------------------- */

/* Before main, before variables are set: after a watchdog reset the watchdog runs on, with 16 ms. */
void read_reset_cause(void) __attribute__((naked, used, section(".init3")));
void read_reset_cause(void)
{
    reset_cause = MCUSR & 0x0F;
    MCUSR = 0;
    wdt_disable();
    if (stuck_mark == MAGIC && stuck_mark_inverse == (uint16_t)~MAGIC)
        reset_cause |= 1 << WDRF;
    stuck_mark = 0;
}

static void start(void)
{
    PORTB = 0;
    DDRB = 1 << DDB1 | 1 << DDB2 | 1 << DDB3;
    known = is_kept();
    for (uint8_t i = 0; i < SERVOS; i++) {
        rest[i] = ANGLE_TICKS(ANGLE_REST);
        current[i] = target[i] = known ? kept[i] : rest[i];
        next_width[i] = current[i];
        lowest[i] = WIDTH_MIN_US * TICKS_PER_US;
        highest[i] = WIDTH_MAX_US * TICKS_PER_US;
    }

    UCSR0A = 1 << U2X0;
    UBRR0 = 16; /* 117647 baud: what every 16 MHz board calls 115200 */
    UCSR0C = 1 << UCSZ01 | 1 << UCSZ00;
    UCSR0B = 1 << RXEN0 | 1 << TXEN0 | 1 << RXCIE0;

    TCCR1A = 0;
    TCCR1B = 1 << CS11; /* divided by 8: 0.5 us a tick */
    OCR1A = TCNT1 + 1000;
    frame_start = OCR1A - LATCH_TICKS; /* the first interrupt latches */
    TIFR1 = 1 << OCF1A;
    TIMSK1 = 1 << OCIE1A;

    set_sleep_mode(SLEEP_MODE_IDLE);
#ifndef NO_WDT
    wdt_enable(WDTO_250MS);
#endif
    sei();
#ifdef IMU
    imu_start();
#endif
#ifndef LEGACY_ONLY
    for (uint8_t i = 0; i < IDENTITY_SEXTETS; i++)
        identity[i] = eeprom_read_byte((const uint8_t *)IDENTITY_PLACE + i) & 0x3F;
    send_banner();
#endif
}

/* Once a frame, after its last pulse: feed the watchdog, so that it also guards the timer interrupt. */
static void serve_frame(void)
{
    move_due = 0;
#ifndef NO_WDT
    wdt_reset();
#endif
    ATOMIC_BLOCK(ATOMIC_FORCEON)
    {
        frames_unfed = 0;
        stuck_mark = 0;
    }
    move_one_frame();
#ifdef IMU
    imu_look();
#else
    drop_old_packet();
#endif
#ifndef LEGACY_ONLY
    write_identity();
    static uint8_t beat;
    beat += 2; /* 20 Hz from 50 Hz: every 5 halves of a frame */
    if (beat >= 5) {
        beat -= 5;
        telemetry_wanted = 1;
    }
#endif
}

int main(void)
{
    start();
    for (;;) {
        while (rx_tail != rx_head) {
            uint8_t byte = rx_ring[rx_tail];
            rx_tail = (rx_tail + 1) & (RX_SIZE - 1);
#ifdef IMU
            parse_text(byte);
#else
            parse(byte);
#endif
            if (move_due)
                break; /* a saturated line must not keep the frame waiting */
        }
        if (move_due)
            serve_frame();
#ifndef LEGACY_ONLY
        if (telemetry_wanted) {
            telemetry_wanted = 0;
            send_telemetry();
        }
        if (identity_wanted && !identity_unwritten) { /* said once it is kept */
            identity_wanted = 0;
            send_frame(IDENTITY, identity, IDENTITY_SEXTETS);
        }
#endif
        cli();
        if (rx_tail == rx_head && !move_due) {
            sleep_enable();
            sei(); /* the instruction after sei runs before any interrupt: no wake-up is lost */
            sleep_cpu();
            sleep_disable();
        }
        sei();
    }
}
