// One question by simonvetter/modbus: client URL UNIT coils|discrete|holding|input|one|many ADDRESS COUNT|VALUES...
package main

import (
	"fmt"
	"os"
	"strconv"
	"time"

	"github.com/simonvetter/modbus"
)

func number(text string) uint16 {
	value, err := strconv.ParseUint(text, 10, 16)
	if err != nil {
		panic(err)
	}
	return uint16(value)
}

func ask(client *modbus.ModbusClient, kind string, address uint16, numbers []uint16) (any, error) {
	switch kind {
	case "coils":
		return client.ReadCoils(address, numbers[0])
	case "discrete":
		return client.ReadDiscreteInputs(address, numbers[0])
	case "holding":
		return client.ReadRegisters(address, numbers[0], modbus.HOLDING_REGISTER)
	case "input":
		return client.ReadRegisters(address, numbers[0], modbus.INPUT_REGISTER)
	case "one":
		return []uint16{}, client.WriteRegister(address, numbers[0])
	}
	return []uint16{}, client.WriteRegisters(address, numbers)
}

func main() {
	client, err := modbus.NewClient(&modbus.ClientConfiguration{
		URL: os.Args[1], Speed: 19200, DataBits: 8, Parity: modbus.PARITY_NONE, StopBits: 1,
		Timeout: 2 * time.Second,
	})
	if err == nil {
		err = client.Open()
	}
	if err != nil {
		fmt.Println(err)
		os.Exit(1)
	}
	client.SetUnitId(uint8(number(os.Args[2])))
	var numbers []uint16
	for _, text := range os.Args[5:] {
		numbers = append(numbers, number(text))
	}
	found, err := ask(client, os.Args[3], number(os.Args[4]), numbers)
	if err != nil {
		fmt.Println(err)
		os.Exit(1)
	}
	fmt.Print("ok")
	switch values := found.(type) {
	case []bool:
		for _, bit := range values {
			if bit {
				fmt.Print(" 1")
			} else {
				fmt.Print(" 0")
			}
		}
	case []uint16:
		for _, value := range values {
			fmt.Print(" ", value)
		}
	}
	fmt.Println()
}
