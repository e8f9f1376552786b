// Asks an OPC UA server by gopcua: client URL read NODE, or client URL write NODE NUMBER
package main

import (
	"context"
	"fmt"
	"os"
	"strconv"
	"time"

	"github.com/gopcua/opcua"
	"github.com/gopcua/opcua/ua"
)

func main() {
	within, cancel := context.WithTimeout(context.Background(), 60*time.Second)
	defer cancel()
	client, err := opcua.NewClient(os.Args[1], opcua.SecurityMode(ua.MessageSecurityModeNone))
	if err == nil {
		err = client.Connect(within)
	}
	if err != nil {
		fmt.Println("no connection:", err)
		os.Exit(1)
	}
	defer client.Close(within)
	node, err := ua.ParseNodeID(os.Args[3])
	if err != nil {
		panic(err)
	}
	if os.Args[2] == "write" {
		number, _ := strconv.ParseFloat(os.Args[4], 64)
		value := &ua.WriteValue{NodeID: node, AttributeID: ua.AttributeIDValue, Value: &ua.DataValue{
			EncodingMask: ua.DataValueValue, Value: ua.MustVariant(number)}}
		answer, err := client.Write(within, &ua.WriteRequest{NodesToWrite: []*ua.WriteValue{value}})
		if err != nil {
			fmt.Println(err)
			return
		}
		fmt.Println(uint32(answer.Results[0]))
		return
	}
	asked := &ua.ReadRequest{NodesToRead: []*ua.ReadValueID{{NodeID: node}}, TimestampsToReturn: ua.TimestampsToReturnBoth}
	answer, err := client.Read(within, asked)
	if err != nil {
		fmt.Println(err)
		return
	}
	found := answer.Results[0]
	if found.Value == nil {
		fmt.Println("nothing", uint32(found.Status))
		return
	}
	fmt.Println(found.Value.Value(), uint32(found.Status))
}
