"""Read the state of a robot with the client of the MCP SDK; see the page *Agents (MCP)*.

python read_state.py arm=sim://ur5e
"""

import argparse
import asyncio
import sys

from mcp import Client
from mcp.client.stdio import StdioServerParameters


async def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", metavar="[NAME=]ADDRESS", help="address of the robot")
    args = parser.parse_args()
    # The client starts the server, and talks to it over standard input and output.
    server = StdioServerParameters(command=sys.executable, args=["-m", "urlink.cli", "serve", "mcp", args.robot])
    async with Client(server) as client:
        tools = (await client.list_tools()).tools
        print("tools:", ", ".join(tool.name for tool in tools))
        result = await client.call_tool("get_state", {})
        state = result.structured_content
        if result.is_error or state is None:
            raise SystemExit(f"refused: {result.content[0].text}")
        print(f"base at {state['q_degrees'][0]:.2f} degrees, {state['safety_mode']}")
        explained = await client.call_tool("explain_stop", {})
        print("stop:", explained.content[0].text)


if __name__ == "__main__":
    asyncio.run(main())
