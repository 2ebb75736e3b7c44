/* A channel to a worker on another machine: there are two of them, one on either side, and what is asked and answered is
 * carried between them (by Python, see cosim/fmi/isolation). On the side of the loop the relay stands in for the worker,
 * on the other side for the master. */
#ifndef _WIN32
#define _GNU_SOURCE
#include "channel_sides.h"
#include "loop.h"

#include <string.h>

/* The side of the loop */

/* Sleep until the master has asked for something new, or for so long (ns); what it has asked for, by its number. */
EXPORT uint32_t relay_asked(Channel *channel, uint32_t before, int64_t longest) {
    __atomic_store_n(&channel->worker_sleeps, 1, __ATOMIC_SEQ_CST);
    if (seen(&channel->asked) == before) sleep_at(&channel->asked, before, longest);
    __atomic_store_n(&channel->worker_sleeps, 0, __ATOMIC_SEQ_CST);
    return seen(&channel->asked);
}

/* What the master has asked for: how many calls, and the bytes that they take in the area. */
EXPORT uint64_t relay_request(const Channel *channel, uint64_t *n_calls) {
    *n_calls = channel->n_calls;
    return channel->used;
}

/* Say at which call the worker was last. */
EXPORT void relay_at(Channel *channel, uint32_t call) { channel->at = call; }

/* Tell the master that it has its answer. */
EXPORT void relay_answer(Channel *channel, uint32_t asked) { tell(&channel->answered, asked, &channel->master_sleeps); }

/* Hand messages on, whole ones, as many as there is room for; how many bytes of them are done with. */
EXPORT uint64_t relay_hand_on(Channel *channel, const uint8_t *messages, uint64_t size) {
    uint64_t done = 0, at = channel->written, read = __atomic_load_n(&channel->read, __ATOMIC_SEQ_CST);
    while (done < size) {
        Message message;
        if (size - done < sizeof message) return size; /* what is there is none of the worker's */
        memcpy(&message, messages + done, sizeof message);
        uint64_t whole = sizeof message + (uint64_t)message.category_size + message.text_size;
        if (whole > size - done || whole > MESSAGES_SIZE) return size;
        if (at + whole - read > MESSAGES_SIZE) break;
        for (uint64_t i = 0; i < whole; i++) channel->messages[(at + i) % MESSAGES_SIZE] = messages[done + i];
        at += whole;
        done += whole;
        __atomic_store_n(&channel->written, at, __ATOMIC_SEQ_CST);
    }
    if (done < size) wake_at(&channel->answered); /* the master makes room */
    return done;
}

/* The side of the worker */

/* Ask the worker for calls, whose bytes are in the area; their number. */
EXPORT uint32_t relay_ask(Channel *channel, uint64_t n_calls, uint64_t used) {
    channel->n_calls = n_calls;
    channel->used = used;
    uint32_t asked = channel->asked + 1;
    tell(&channel->asked, asked, &channel->worker_sleeps);
    return asked;
}

/* Sleep until the worker has answered, or has messages for which it needs room, or for so long (ns); whether it has
 * answered. */
EXPORT bool relay_is_answered(Channel *channel, uint32_t asked, int64_t longest) {
    uint32_t before = seen(&channel->answered);
    if (before == asked) return true;
    __atomic_store_n(&channel->master_sleeps, 1, __ATOMIC_SEQ_CST);
    if (seen(&channel->answered) == before) sleep_at(&channel->answered, before, longest);
    __atomic_store_n(&channel->master_sleeps, 0, __ATOMIC_SEQ_CST);
    return seen(&channel->answered) == asked;
}

/* How far the answer reaches in the area, and at which call the worker is. */
EXPORT uint64_t relay_reach(const Channel *channel, uint32_t *call) {
    *call = channel->at;
    return channel->reach;
}

/* Take the messages that have come, as they stand, into a buffer of MESSAGES_SIZE bytes; how many bytes they are. */
EXPORT uint64_t relay_take(Channel *channel, uint8_t *messages) {
    uint64_t written = __atomic_load_n(&channel->written, __ATOMIC_SEQ_CST), read = channel->read;
    uint64_t size = written - read > MESSAGES_SIZE ? 0 : written - read;
    for (uint64_t i = 0; i < size; i++) messages[i] = channel->messages[(read + i) % MESSAGES_SIZE];
    __atomic_store_n(&channel->read, written, __ATOMIC_SEQ_CST);
    return size;
}

/* Bytes of messages that a channel holds. */
EXPORT uint64_t relay_room(void) { return MESSAGES_SIZE; }
#endif
