/* Build switch IMU: a BNO055 orientation sensor on the I2C pins (A4, A5), and the text protocol of the closed loop.
 *
 *   to the board:    n0 n1 n2 LF      servo bytes 60..180 in text, 57600 baud
 *   from the board:  a,b, CR LF       degrees with four decimals, an answer to every line; "no imu" without a sensor
 *
 * The sensor hangs upside down under the effector. Its third Euler angle (register 0x1E) is then near 180 degrees
 * where the effector is level, so 180 degrees are taken off and the result is brought into -180..180; its second one
 * (register 0x1C) has the opposite sign. a is the corrected third angle, b the second one with its sign changed.
 */
#include <util/twi.h>

#define IMU_ADDRESS 0x28u
#define IMU_CHIP_ID 0xA0u
#define IMU_TURN (360 * 16) /* the sensor counts sixteenths of a degree */
enum { IMU_REGISTER_ID = 0x00, IMU_REGISTER_ROLL = 0x1C, IMU_REGISTER_MODE = 0x3D, IMU_MODE_FUSION = 0x0C };
#define IMU_RETRY_FRAMES 50u

static uint8_t imu_ready;

/* One step on the bus: the status it ends with, or 0 where it does not end. */
static uint8_t bus_step(uint8_t control)
{
    TWCR = 1 << TWINT | 1 << TWEN | control;
    for (uint16_t wait = 0; wait < 2000; wait++) /* 0.7 ms: a sensor may stretch the clock */
        if (TWCR & (1 << TWINT))
            return TWSR & 0xF8;
    return 0;
}

static uint8_t bus_send(uint8_t byte) /* whether it was acknowledged, an address or a byte */
{
    uint8_t status;
    TWDR = byte;
    status = bus_step(0);
    return status == TW_MT_SLA_ACK || status == TW_MT_DATA_ACK || status == TW_MR_SLA_ACK;
}

static void bus_stop(void)
{
    TWCR = 1 << TWINT | 1 << TWEN | 1 << TWSTO;
}

static uint8_t imu_write(uint8_t reg, uint8_t value)
{
    uint8_t done = bus_step(1 << TWSTA) == TW_START && bus_send(IMU_ADDRESS << 1) && bus_send(reg) && bus_send(value);
    bus_stop();
    return done;
}

static uint8_t imu_read(uint8_t reg, uint8_t *bytes, uint8_t length)
{
    uint8_t done = bus_step(1 << TWSTA) == TW_START && bus_send(IMU_ADDRESS << 1) && bus_send(reg)
        && bus_step(1 << TWSTA) == TW_REP_START && bus_send(IMU_ADDRESS << 1 | 1);
    for (uint8_t i = 0; done && i < length; i++) {
        uint8_t last = i + 1 == length;
        done = last ? bus_step(0) == TW_MR_DATA_NACK : bus_step(1 << TWEA) == TW_MR_DATA_ACK;
        bytes[i] = TWDR;
    }
    bus_stop();
    return done;
}

/* Look for the sensor about once a second until it answers; it takes most of a second to start. */
static void imu_look(void)
{
    static uint8_t frames;
    uint8_t id;
    if (imu_ready || ++frames < IMU_RETRY_FRAMES)
        return;
    frames = 0;
    imu_ready = imu_read(IMU_REGISTER_ID, &id, 1) && id == IMU_CHIP_ID && imu_write(IMU_REGISTER_MODE, IMU_MODE_FUSION);
}

static void put_char(char c)
{
    uint8_t next = (tx_head + 1) & (TX_SIZE - 1);
    if (next == tx_tail)
        return;
    tx_ring[tx_head] = (uint8_t)c;
    tx_head = next;
}

static void put_text(const char *text)
{
    while (*text)
        put_char(*text++);
}

/* Sixteenths of a degree as a decimal number with four decimals: they are exact. */
static void put_angle(int16_t angle)
{
    uint16_t size = angle < 0 ? (uint16_t)-angle : (uint16_t)angle;
    uint16_t parts[2] = {size >> 4, (size & 15) * 625u};
    if (angle < 0)
        put_char('-');
    for (uint8_t part = 0; part < 2; part++) {
        uint8_t started_number = part;
        for (uint16_t unit = 1000; unit; unit /= 10) {
            uint8_t digit = parts[part] / unit % 10;
            started_number |= digit || unit == 1;
            if (started_number)
                put_char('0' + digit);
        }
        put_char(part ? ',' : '.');
    }
}

static void imu_answer(void)
{
    uint8_t raw[4];
    if (imu_ready)
        imu_ready = imu_read(IMU_REGISTER_ROLL, raw, sizeof raw);
    if (imu_ready) {
        int16_t second = (int16_t)(raw[0] | (uint16_t)raw[1] << 8);
        int16_t third = (int16_t)(raw[2] | (uint16_t)raw[3] << 8);
        put_angle(third >= 0 ? third - IMU_TURN / 2 : third + IMU_TURN / 2);
        put_angle(-second);
    } else {
        put_text("no imu");
    }
    put_text("\r\n");
    ATOMIC_BLOCK(ATOMIC_FORCEON) { UCSR0B |= 1 << UDRIE0; }
}

/* Text parser: three whole numbers and a line feed are a pose; every line is answered. */
static void parse_text(uint8_t byte)
{
    static uint16_t number[SERVOS];
    static uint8_t index, digits, broken, any;
    if (byte == '\n') {
        if (digits)
            index++;
        if (!broken && index == SERVOS) {
            uint16_t ticks[SERVOS];
            for (uint8_t i = 0; i < SERVOS; i++) {
                broken |= number[i] < ANGLE_MIN || number[i] > ANGLE_MAX;
                ticks[i] = ANGLE_TICKS(number[i]);
            }
            if (!broken)
                command_pose(ticks);
        }
        if (any)
            imu_answer();
        index = digits = broken = any = 0;
        return;
    }
    any |= byte != '\r';
    if (byte >= '0' && byte <= '9' && index < SERVOS && digits < 3) {
        number[index] = (digits ? number[index] * 10u : 0u) + byte - '0';
        digits++;
    } else if ((byte == ' ' || byte == '\r') && index < SERVOS) {
        if (digits)
            index++;
        digits = 0;
    } else if (byte != ' ' && byte != '\r') {
        broken = 1;
    }
}

static void imu_start(void)
{
    UBRR0 = 34; /* 57143 baud */
    TWBR = 12;  /* 400 kHz */
    put_text("softsim tripod with IMU\r\n");
    ATOMIC_BLOCK(ATOMIC_FORCEON) { UCSR0B |= 1 << UDRIE0; }
}
