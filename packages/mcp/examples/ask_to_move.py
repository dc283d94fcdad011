"""Ask to turn the base of an arm, and decide about it in the terminal; see the page *Agents (MCP)*.

python ask_to_move.py arm=sim://ur5e
"""

import argparse
import asyncio
import math
import sys
from typing import Any

from mcp import Client
from mcp.client.stdio import StdioServerParameters
from mcp_types import ElicitResult


async def ask_in_terminal(context: Any, params: Any) -> ElicitResult:
    """Show the question of the server. Only the word yes is a consent."""
    print(params.message)
    print("yes or no? ", end="", flush=True)
    answer = await asyncio.to_thread(sys.stdin.readline)
    if answer.strip().lower() == "yes":
        return ElicitResult(action="accept", content={"consent": True})
    return ElicitResult(action="decline")


async def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", metavar="[NAME=]ADDRESS", help="address of the robot")
    parser.add_argument("--limits", default="teaching", help="limits of the session (default: teaching)")
    parser.add_argument("--degrees", type=float, default=5.0, help="turn of the base (default: 5)")
    args = parser.parse_args()
    command = ["-m", "urlink.cli", "serve", "mcp", args.robot, "--allow", "--limits", args.limits]
    server = StdioServerParameters(command=sys.executable, args=command)
    async with Client(server, elicitation_callback=ask_in_terminal) as client:
        state = (await client.call_tool("get_state", {})).structured_content
        assert state is not None
        q = state["q_rad"]
        q[0] += math.radians(args.degrees)
        result = await client.call_tool("move_joints", {"q": q, "speed": 0.2})
        print("refused:" if result.is_error else "result:", result.content[0].text)


if __name__ == "__main__":
    asyncio.run(main())
