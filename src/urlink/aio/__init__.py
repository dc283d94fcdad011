"""Robot connections for programs that use asyncio.

    async with urlink.connect_async("192.168.56.101") as robot:
        async for state in robot.realtime:
            print(state.q_actual)

The event loop reads the streams, without additional threads.
"""
